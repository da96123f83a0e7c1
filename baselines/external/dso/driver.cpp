// Feeds an EuRoC folder to DSO in the order of the stamps, and writes the paths it then has.
//
//   dso CAMERA.txt FOLDER OUT.tum SHIFT_S [SETTING=VALUE ...]
//
// OUT.tum has T_world_camera of all tracked pictures as they are in the end, in a world without scale; OUT.online.tum has
// each as it was known at its time. SHIFT_S is added to the stamps of the pictures. Tracking and mapping take turns, in one
// thread, so that the load of the machine decides nothing. After DSO is lost, pictures have no pose, as upstream ends there.

#include <cmath>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "FullSystem/FullSystem.h"
#include "IOWrapper/Output3DWrapper.h"
#include "folder.h"
#include "util/Undistort.h"
#include "util/globalCalib.h"
#include "util/settings.h"

namespace {

constexpr std::size_t RESTARTS_UNTIL = 250;  // pictures; upstream's main takes a failed start for one only among these

const std::map<std::string, float *> REALS = {
    {"desired_immature_density", &dso::setting_desiredImmatureDensity},
    {"desired_point_density", &dso::setting_desiredPointDensity},
    {"kf_global_weight", &dso::setting_kfGlobalWeight},
    {"min_grad_hist_cut", &dso::setting_minGradHistCut},
    {"min_grad_hist_add", &dso::setting_minGradHistAdd},
    {"outlier_th", &dso::setting_outlierTH},
    {"huber_th", &dso::setting_huberTH},
    {"coarse_cutoff_th", &dso::setting_coarseCutoffTH},
    {"max_pix_search", &dso::setting_maxPixSearch},
};
const std::map<std::string, int *> INTEGERS = {
    {"min_frames", &dso::setting_minFrames},
    {"max_frames", &dso::setting_maxFrames},
    {"max_opt_iterations", &dso::setting_maxOptIterations},
};

bool set(const std::string &word) {
  const std::size_t equals = word.find('=');
  const std::string key = word.substr(0, equals);
  if (equals == std::string::npos || (!REALS.count(key) && !INTEGERS.count(key)))
    return false;
  if (REALS.count(key))
    *REALS.at(key) = std::stof(word.substr(equals + 1));
  else
    *INTEGERS.at(key) = std::stoi(word.substr(equals + 1));
  return true;
}

struct Pose {
  int picture;
  dso::SE3 T_world_camera;
};

// The pose of each tracked picture at its time.
struct Online : dso::IOWrap::Output3DWrapper {
  std::vector<Pose> poses;
  void publishCamPose(dso::FrameShell *shell, dso::CalibHessian *) override {
    poses.push_back({shell->incoming_id, shell->camToWorld});
  }
  void reset() override { poses.clear(); }
};

std::unique_ptr<dso::FullSystem> begin(Online &online, float *gamma) {
  auto system = std::make_unique<dso::FullSystem>();
  system->setGammaFunction(gamma);
  system->linearizeOperation = true;
  system->outputWrapper.push_back(&online);
  return system;
}

// Key frames are where the last adjustment that they were part of left them, other pictures relative to theirs.
std::vector<Pose> final_path(const dso::FullSystem &system) {
  const std::set<const dso::FrameShell *> keys(system.allKeyFramesHistory.begin(), system.allKeyFramesHistory.end());
  std::vector<Pose> poses;
  for (const dso::FrameShell *shell : system.allFrameHistory) {
    if (!shell->poseValid || (system.isLost && shell == system.allFrameHistory.back()))
      continue;
    const bool relative = !keys.count(shell) && shell->trackingRef != nullptr;
    poses.push_back({shell->incoming_id,
                     relative ? shell->trackingRef->camToWorld * shell->camToTrackingRef : shell->camToWorld});
  }
  return poses;
}

void write(const std::string &path, const std::vector<Pose> &poses, const std::vector<ImageRow> &rows, int64_t shift_ns) {
  std::ofstream out(path);
  for (const Pose &pose : poses) {
    const Eigen::Vector3d t = pose.T_world_camera.translation();
    const Eigen::Quaterniond q = pose.T_world_camera.unit_quaternion();
    out << std::fixed << std::setprecision(9) << seconds(rows[pose.picture].stamp_ns + shift_ns) << std::setprecision(7);
    for (double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()})
      out << ' ' << value;
    out << '\n';
  }
}

}  // namespace

int main(int argc, char **argv) {
  if (argc < 5) {
    std::cerr << "usage: dso CAMERA.txt FOLDER OUT.tum SHIFT_S [SETTING=VALUE ...]" << std::endl;
    return 2;
  }
  for (int i = 5; i < argc; i++)
    if (!set(argv[i])) {
      std::cerr << argv[i] << ": DSO has no such setting" << std::endl;
      return 2;
    }
  // What upstream's main sets for mode=1 (no photometric calibration), nomt=1, quiet=1, nolog=1.
  dso::setting_photometricCalibration = 0;
  dso::setting_affineOptModeA = 0;
  dso::setting_affineOptModeB = 0;
  dso::multiThreading = false;
  dso::disableAllDisplay = true;
  dso::setting_debugout_runquiet = true;
  dso::setting_logStuff = false;

  const std::vector<ImageRow> rows = read_images(std::string(argv[2]) + "/mav0/cam0");
  const std::unique_ptr<dso::Undistort> undistort(dso::Undistort::getUndistorterForFile(argv[1], "", ""));
  if (!undistort)
    return 1;
  dso::setGlobalCalib(undistort->getSize()[0], undistort->getSize()[1], undistort->getK().cast<float>());
  float *gamma = undistort->photometricUndist->getG();
  Online online;
  std::unique_ptr<dso::FullSystem> system = begin(online, gamma);
  for (std::size_t i = 0; i < rows.size() && !system->isLost; i++) {
    if (i % std::max<std::size_t>(1, rows.size() / 10) == 0)
      std::cout << "progress " << i << " of " << rows.size() << std::endl;
    const cv::Mat picture = cv::imread(rows[i].path, cv::IMREAD_GRAYSCALE);
    if (picture.empty()) {
      std::cerr << rows[i].path << ": not a picture" << std::endl;
      return 1;
    }
    dso::MinimalImageB raw(picture.cols, picture.rows);
    std::memcpy(raw.data, picture.data, picture.total());
    const std::unique_ptr<dso::ImageAndExposure> image(
        undistort->undistort<unsigned char>(&raw, 1.0f, seconds(rows[i].stamp_ns)));
    system->addActiveFrame(image.get(), int(i));
    if (system->initFailed && i < RESTARTS_UNTIL) {
      std::cout << "begins anew after " << i + 1 << " pictures" << std::endl;
      online.reset();
      system.reset();
      system = begin(online, gamma);
    }
  }
  if (!system->initialized) {
    std::cerr << "DSO never initialised" << std::endl;
    return 1;
  }
  const std::string path = argv[3];
  const int64_t shift_ns = std::llround(std::stod(argv[4]) * 1e9);
  const std::vector<Pose> poses = final_path(*system);
  write(path, poses, rows, shift_ns);
  write(path.substr(0, path.rfind('.')) + ".online.tum", online.poses, rows, shift_ns);
  std::cout << poses.size() << " poses of " << rows.size() << " pictures" << (system->isLost ? ", then lost" : "")
            << std::endl;
  return 0;
}
