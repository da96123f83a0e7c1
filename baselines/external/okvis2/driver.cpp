// Feeds an EuRoC folder to OKVIS2 in the order of the stamps, and writes the paths it then has.
//
//   okvis2 CONFIG.yaml VOCABULARY_FOLDER FOLDER OUT.tum SHIFT_S
//
// OUT.tum has the poses of all pictures as they are in the end, OUT.online.tum each as it was known at its time: T_world_imu
// with gravity along -z. SHIFT_S is added to the stamps of the pictures, as OKVIS2 knows of no offset between the clocks.
// Each picture is matched and adjusted before the next is read, so that the load of the machine does not decide anything.

#include <cmath>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include <glog/logging.h>
#include <okvis/ThreadedSlam.hpp>
#include <okvis/ViParametersReader.hpp>
#include <opencv2/imgcodecs.hpp>

#include "folder.h"

namespace {

constexpr int64_t TOGETHER_NS = 5'000'000;  // the authors' timestamp_tolerance
constexpr int64_t OVERLAP_NS = 20'000'000;  // upstream waits for inertial measurements up to 20 ms after a picture

okvis::Time time_of(int64_t stamp_ns) {
  return okvis::Time(uint32_t(stamp_ns / 1'000'000'000), uint32_t(stamp_ns % 1'000'000'000));
}

void write_pose(std::ofstream &out, const okvis::Time &time, const okvis::kinematics::Transformation &T_world_imu) {
  const Eigen::Vector3d t = T_world_imu.r();
  const Eigen::Quaterniond q = T_world_imu.q();
  out << time.sec << '.' << std::setw(9) << std::setfill('0') << time.nsec << std::fixed << std::setprecision(7);
  for (double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()})
    out << ' ' << value;
  out << '\n';
}

// Not upstream's addImuMeasurement, which waits for ever where more than 500 come between two pictures.
void add_imu(okvis::ThreadedSlam &slam, const ImuRow &row) {
  okvis::ImuMeasurement one;
  one.timeStamp = time_of(row.stamp_ns);
  one.measurement.gyroscopes = Eigen::Vector3d(row.gyro);
  one.measurement.accelerometers = Eigen::Vector3d(row.accel);
  slam.imuMeasurementsReceived_.PushNonBlocking(one);
}

// A picture is kept by its pose relative to a key frame, unless it is one.
long write_path(const okvis::ViGraph &graph, const std::string &path) {
  std::ofstream out(path);
  for (const auto &[id, kept] : graph.anyState_) {
    const bool relative = kept.keyframeId.isInitialised();
    const okvis::kinematics::Transformation T_world_key =
        graph.states_.at(relative ? kept.keyframeId : id).pose->estimate();
    write_pose(out, kept.timestamp, relative ? T_world_key * kept.T_Sk_S : T_world_key);
  }
  return long(graph.anyState_.size());
}

}  // namespace

int main(int argc, char **argv) {
  if (argc != 6) {
    std::cerr << "usage: okvis2 CONFIG.yaml VOCABULARY_FOLDER FOLDER OUT.tum SHIFT_S" << std::endl;
    return 2;
  }
  google::InitGoogleLogging(argv[0]);
  FLAGS_logtostderr = true;
  FLAGS_log_prefix = false;
  okvis::ViParameters parameters;
  okvis::ViParametersReader(argv[1]).getParameters(parameters);
  const std::string folder = std::string(argv[3]) + "/mav0/";
  const std::vector<ImuRow> imu = read_imu(folder + "imu0/data.csv");
  const auto pairs = taken_together(folder, parameters.nCameraSystem.numCameras(), TOGETHER_NS);
  if (pairs.empty())
    return 1;

  okvis::ThreadedSlam slam(parameters, argv[2]);
  slam.setBlocking(true);
  const int64_t shift_ns = std::llround(std::stod(argv[5]) * 1e9);
  const std::string path = argv[4];
  std::ofstream online(path.substr(0, path.rfind('.')) + ".online.tum");
  std::size_t next = 0;
  for (const auto &rows : pairs) {
    tell_progress(&rows - pairs.data(), pairs.size());
    std::map<std::size_t, cv::Mat> pictures;
    for (std::size_t i = 0; i < rows.size(); i++) {
      pictures[i] = cv::imread(rows[i].path, cv::IMREAD_GRAYSCALE);
      if (pictures[i].empty()) {
        std::cerr << rows[i].path << ": not a picture" << std::endl;
        return 1;
      }
    }
    const int64_t stamp_ns = rows[0].stamp_ns + shift_ns;
    while (next < imu.size() && (next == 0 || imu[next - 1].stamp_ns < stamp_ns + OVERLAP_NS))
      add_imu(slam, imu[next++]);
    if (next == 0 || imu[next - 1].stamp_ns < stamp_ns + OVERLAP_NS)
      break;  // it would wait for measurements that do not come
    slam.addImages(time_of(stamp_ns), pictures);
    slam.processFrame();
    if (slam.optimisationThread_.joinable())
      slam.optimisationThread_.join();
    const okvis::ViSlamBackend &backend = slam.estimator_;
    if (!slam.frontend_.isInitialized() || backend.numFrames() == 0)
      continue;
    const okvis::StateId current = backend.currentStateId();
    if (backend.timestamp(current) == time_of(stamp_ns))
      write_pose(online, time_of(stamp_ns), backend.pose(current));
  }
  slam.stopThreading();
  if (!slam.frontend_.isInitialized()) {
    std::cerr << "OKVIS2 never initialised" << std::endl;
    return 1;
  }
  if (parameters.estimator.do_final_ba)
    slam.doFinalBa();
  const long written = write_path(slam.estimator_.realtimeGraph_, path);
  std::cout << written << " poses of " << pairs.size() << " pictures" << std::endl;
  return 0;
}
