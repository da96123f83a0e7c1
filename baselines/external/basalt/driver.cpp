// Feeds an EuRoC folder to Basalt's visual-inertial odometry, picture by picture, and writes the pose after each.
//
//   basalt CONFIG.json CALIBRATION.json FOLDER OUT.tum GRAVITY
//
// Poses are T_world_imu, gravity (m/s^2) along -z; their stamps are of the clock of the IMU. There are as many cameras as
// the calibration has. The state at each picture is waited for before the next is given, and nothing runs beside it: what
// else the machine does, and the order of threads, change nothing.

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/opencv.hpp>
#include <tbb/global_control.h>

#include <basalt/optical_flow/optical_flow.h>
#include <basalt/serialization/headers_serialization.h>
#include <basalt/vi_estimator/sqrt_keypoint_vio.h>

#include "folder.h"

namespace {

basalt::ManagedImage<uint16_t>::Ptr in_16_bits(const cv::Mat &picture) {
  auto found = std::make_shared<basalt::ManagedImage<uint16_t>>(picture.cols, picture.rows);
  picture.convertTo(cv::Mat(picture.rows, picture.cols, CV_16UC1, found->ptr), CV_16UC1, 256);
  return found;
}

void write_pose(std::ofstream &out, int64_t stamp_ns, const Sophus::SE3d &T_world_imu) {
  const Eigen::Vector3d t = T_world_imu.translation();
  const Eigen::Quaterniond q = T_world_imu.unit_quaternion();
  out << std::setprecision(9) << seconds(stamp_ns) << std::setprecision(7);
  for (double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()})
    out << ' ' << value;
  out << '\n';
}

}  // namespace

int main(int argc, char **argv) {
  if (argc != 6) {
    std::cerr << "usage: basalt CONFIG.json CALIBRATION.json FOLDER OUT.tum GRAVITY" << std::endl;
    return 2;
  }
  basalt::VioConfig config;
  config.load(argv[1]);
  basalt::Calibration<double> calibration;
  std::ifstream file(argv[2]);
  cereal::JSONInputArchive archive(file);
  archive(calibration);

  const std::string folder = std::string(argv[3]) + "/mav0/";
  const std::vector<ImuRow> imu = read_imu(folder + "imu0/data.csv");
  const auto pairs = taken_together(folder, calibration.intrinsics.size());
  if (pairs.empty())
    return 1;
  if (imu.empty()) {
    std::cerr << folder << ": no inertial measurements" << std::endl;
    return 1;
  }

  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  cv::setNumThreads(1);
  const auto flow = basalt::OpticalFlowFactory::getOpticalFlow(config, calibration);
  basalt::SqrtKeypointVioEstimator<float> odometry(Eigen::Vector3d(0, 0, -std::stod(argv[5])), calibration, config);
  tbb::concurrent_bounded_queue<basalt::PoseVelBiasState<double>::Ptr> states;
  flow->output_queue = &odometry.vision_data_queue;
  odometry.out_state_queue = &states;
  odometry.initialize(Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero());  // biases; begins its thread

  std::ofstream out(argv[4]);
  out << std::fixed;
  const std::size_t tenth = std::max<std::size_t>(pairs.size() / 10, 1);
  std::size_t next = 0, given = 0;
  long written = 0;
  for (const auto &rows : pairs) {
    if (++given % tenth == 0)
      std::cout << "progress " << given << " of " << pairs.size() << std::endl;
    auto pictures = std::make_shared<basalt::OpticalFlowInput>();
    pictures->t_ns = rows[0].stamp_ns + calibration.cam_time_offset_ns;  // which Basalt leaves to its caller
    if (imu.back().stamp_ns <= pictures->t_ns)
      break;  // it would wait for a measurement past the picture
    for (const ImageRow &row : rows) {
      const cv::Mat picture = cv::imread(row.path, cv::IMREAD_GRAYSCALE);
      if (picture.empty()) {
        std::cerr << row.path << ": not a picture" << std::endl;
        std::_Exit(1);  // its threads wait for more
      }
      pictures->img_data.emplace_back();
      pictures->img_data.back().img = in_16_bits(picture);
    }
    flow->input_queue.push(pictures);
    for (; next == 0 || imu[next - 1].stamp_ns <= pictures->t_ns; next++) {
      auto measured = std::make_shared<basalt::ImuData<double>>();
      measured->t_ns = imu[next].stamp_ns;
      measured->gyro = Eigen::Vector3d(imu[next].gyro);
      measured->accel = Eigen::Vector3d(imu[next].accel);
      odometry.imu_data_queue.push(measured);
    }
    basalt::PoseVelBiasState<double>::Ptr state;
    states.pop(state);
    write_pose(out, state->t_ns, state->T_w_i);
    written++;
  }
  std::cout << written << " poses of " << pairs.size() << " pictures" << std::endl;
  if (written == 0) {
    std::cerr << folder << ": no picture has inertial measurements after it" << std::endl;
    std::_Exit(1);
  }
  flow->input_queue.push(nullptr);
  odometry.maybe_join();
  return 0;
}
