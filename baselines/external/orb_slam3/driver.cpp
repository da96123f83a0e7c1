// Feeds an EuRoC folder to ORB-SLAM3 in the order of the stamps, and writes the paths it then has.
//
//   orb_slam3 mono|mono_inertial|stereo_inertial SETTINGS.yaml VOCABULARY FOLDER OUT.tum SHIFT_S SEED
//
// OUT.tum has the poses of all pictures of the largest map, as they are in the end: T_world_imu with gravity along -z
// where there is an inertial unit, else T_world_camera. SHIFT_S is added to the stamps of the pictures, as ORB-SLAM3 knows
// of no offset between the clocks. OUT.online.tum has each pose as it was known at its time, in a world that is turned and
// scaled anew whenever the map is. Before the next picture is read, the mapping of the last one is waited for, and any
// closing of a loop, so that the load of the machine does not decide what becomes of a picture.

#include <chrono>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include <opencv2/opencv.hpp>

#include "Atlas.h"
#include "KeyFrame.h"
#include "LocalMapping.h"
#include "LoopClosing.h"
#include "Map.h"
#include "System.h"
#include "Thirdparty/DBoW2/DUtils/Random.h"
#include "Tracking.h"
#include "folder.h"

namespace {

constexpr int64_t TOGETHER_NS = 10'000'000;  // the authors' maxTimeDiff

bool mapped(ORB_SLAM3::System &system) {
  ORB_SLAM3::LocalMapping &mapping = *system.mpLocalMapper;
  return mapping.KeyframesInQueue() == 0 && mapping.AcceptKeyFrames() && !mapping.stopRequested() &&
         !mapping.isStopped() && !system.mpLoopCloser->CheckNewKeyFrames() && !system.mpLoopCloser->isRunningGBA();
}

bool finished(ORB_SLAM3::System &system) {
  return system.mpLocalMapper->isFinished() && system.mpLoopCloser->isFinished() && !system.mpLoopCloser->isRunningGBA();
}

void wait_until(bool (*condition)(ORB_SLAM3::System &), ORB_SLAM3::System &system) {
  while (!condition(system))
    std::this_thread::sleep_for(std::chrono::microseconds(200));
}

ORB_SLAM3::Map *largest_map(ORB_SLAM3::System &system) {
  ORB_SLAM3::Map *largest = nullptr;
  for (ORB_SLAM3::Map *map : system.mpAtlas->GetAllMaps())
    if (largest == nullptr || map->GetAllKeyFrames().size() > largest->GetAllKeyFrames().size())
      largest = map;
  return largest;
}

void write_pose(std::ofstream &out, double time, const Sophus::SE3f &T_world) {
  const Eigen::Vector3f t = T_world.translation();
  const Eigen::Quaternionf q = T_world.unit_quaternion();
  out << std::fixed << std::setprecision(9) << time << std::setprecision(7);
  for (float value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()})
    out << ' ' << value;
  out << '\n';
}

// Each picture is kept by its pose relative to a key frame, which may have been merged into its parent since.
long write_path(ORB_SLAM3::System &system, bool inertial, const std::string &path) {
  ORB_SLAM3::Map *largest = largest_map(system);
  const ORB_SLAM3::Tracking &tracker = *system.mpTracker;
  std::ofstream out(path);
  long written = 0;
  auto reference = tracker.mlpReferences.begin();
  auto stamp = tracker.mlFrameTimes.begin();
  auto lost = tracker.mlbLost.begin();
  for (const Sophus::SE3f &relative : tracker.mlRelativeFramePoses) {
    ORB_SLAM3::KeyFrame *key = *reference++;
    const double time = *stamp++;
    if (*lost++ || key == nullptr)
      continue;
    Sophus::SE3f T_key_kept;
    while (key != nullptr && key->isBad()) {
      T_key_kept = T_key_kept * key->mTcp;
      key = key->GetParent();
    }
    if (key == nullptr || key->GetMap() != largest)
      continue;
    const Sophus::SE3f T_cam_world = relative * T_key_kept * key->GetPose();
    write_pose(out, time, (inertial ? key->mImuCalib.mTbc * T_cam_world : T_cam_world).inverse());
    written++;
  }
  return written;
}

}  // namespace

int main(int argc, char **argv) {
  using Sensor = ORB_SLAM3::System;
  const std::string mode = argc == 8 ? argv[1] : "";
  Sensor::eSensor sensor;
  if (mode == "mono")
    sensor = Sensor::MONOCULAR;
  else if (mode == "mono_inertial")
    sensor = Sensor::IMU_MONOCULAR;
  else if (mode == "stereo_inertial")
    sensor = Sensor::IMU_STEREO;
  else {
    std::cerr << "usage: orb_slam3 mono|mono_inertial|stereo_inertial SETTINGS.yaml VOCABULARY FOLDER OUT.tum SHIFT_S "
              << "SEED" << std::endl;
    return 2;
  }
  const bool inertial = sensor != Sensor::MONOCULAR, stereo = sensor == Sensor::IMU_STEREO;
  const std::string folder = std::string(argv[4]) + "/mav0/";
  const auto pairs = taken_together(folder, stereo ? 2 : 1, TOGETHER_NS);
  if (pairs.empty())
    return 1;
  const std::vector<ImuRow> imu = read_imu(folder + "imu0/data.csv");

  DUtils::Random::SeedRandOnce(std::stoi(argv[7]));  // upstream's own is 0
  ORB_SLAM3::System system(argv[3], argv[2], sensor, false);
  // Upstream reads this key in files of its old form only.
  system.mpTracker->mFastInit = int(cv::FileStorage(argv[2], cv::FileStorage::READ)["IMU.fastInit"]) != 0;
  const int64_t shift_ns = std::llround(std::stod(argv[6]) * 1e9);
  const std::string path = argv[5];
  std::ofstream online(path.substr(0, path.rfind('.')) + ".online.tum");
  std::size_t next = 0;
  for (const auto &rows : pairs) {
    const ImageRow &row = rows.front();
    const cv::Mat picture = cv::imread(row.path, cv::IMREAD_GRAYSCALE);
    const cv::Mat second = stereo ? cv::imread(rows.back().path, cv::IMREAD_GRAYSCALE) : cv::Mat();
    if (picture.empty() || (stereo && second.empty())) {
      std::cerr << row.path << ": not a picture" << std::endl;
      return 1;
    }
    std::vector<ORB_SLAM3::IMU::Point> measured;
    for (; inertial && next < imu.size() && imu[next].stamp_ns <= row.stamp_ns + shift_ns; next++) {
      const ImuRow &m = imu[next];
      measured.emplace_back(m.accel[0], m.accel[1], m.accel[2], m.gyro[0], m.gyro[1], m.gyro[2], seconds(m.stamp_ns));
    }
    const double time = seconds(row.stamp_ns + shift_ns);
    const Sophus::SE3f T_cam_world = stereo ? system.TrackStereo(picture, second, time, measured)
                                            : system.TrackMonocular(picture, time, measured);
    if (system.GetTrackingState() == ORB_SLAM3::Tracking::OK && (!inertial || system.mpAtlas->isImuInitialized()))
      write_pose(online, time, (inertial ? system.mpTracker->mpImuCalib->mTbc * T_cam_world : T_cam_world).inverse());
    wait_until(mapped, system);
    tell_progress(&rows - pairs.data(), pairs.size());
  }
  system.Shutdown();
  wait_until(finished, system);
  const ORB_SLAM3::Map *largest = largest_map(system);
  if (inertial && (largest == nullptr || !const_cast<ORB_SLAM3::Map *>(largest)->isImuInitialized())) {
    std::cerr << "ORB-SLAM3 never initialised its inertial unit" << std::endl;
    return 1;
  }
  const long written = write_path(system, inertial, path);
  std::cout << written << " poses of " << pairs.size() << " pictures, " << system.mpAtlas->GetAllMaps().size() << " maps"
            << std::endl;
  if (written == 0) {
    std::cerr << "ORB-SLAM3 never initialised" << std::endl;
    return 1;
  }
  std::cout.flush();
  online.flush();
  std::_Exit(0);  // its threads are still alive, and its destructors are not made for that
}
