// Feeds an EuRoC folder to VINS-Fusion in the order of the stamps, and writes the pose after each optimisation.
//
//   vins_fusion CONFIG.yaml FOLDER OUT.tum
//
// Poses are T_world_imu, gravity along -z; their stamps are of the clock of the IMU. With `multiple_thread: 1` upstream
// tracks each picture and optimises each second one, with 0 each; either way the next is read when that is done, so that
// the load of the machine decides nothing.

#include <atomic>
#include <chrono>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include <opencv2/opencv.hpp>

#include "estimator/estimator.h"
#include "estimator/parameters.h"
#include "folder.h"
#include "outputs.h"

namespace {

Estimator estimator;  // upstream's is a global, too: its constructor takes members for zero
std::ofstream out;
long written = 0;
constexpr int64_t TOGETHER_NS = 3'000'000;  // the authors' tolerance in sync_process
std::atomic<double> optimised{-1};  // stamp of the last picture that was

}  // namespace

// Upstream writes the same pose to its vio.csv, with the stamp of the picture.
void pubOdometry(const Estimator &system, const std_msgs::Header &header) {
  const Eigen::Vector3d position = system.Ps[WINDOW_SIZE];
  if (system.solver_flag == Estimator::NON_LINEAR && position.allFinite()) {
    const Eigen::Quaterniond q(system.Rs[WINDOW_SIZE]);
    out << std::fixed << std::setprecision(9) << header.stamp.toSec() + system.td << std::setprecision(7);
    for (double value : {position.x(), position.y(), position.z(), q.x(), q.y(), q.z(), q.w()})
      out << ' ' << value;
    out << '\n';
    written++;
  }
  optimised = header.stamp.toSec();
}

void pubTrackImage(const cv::Mat &, const double) {}
void pubLatestOdometry(const Eigen::Vector3d &, const Eigen::Quaterniond &, const Eigen::Vector3d &, double) {}
void printStatistics(const Estimator &, double) {}
void pubKeyPoses(const Estimator &, const std_msgs::Header &) {}
void pubCameraPose(const Estimator &, const std_msgs::Header &) {}
void pubPointCloud(const Estimator &, const std_msgs::Header &) {}
void pubKeyframe(const Estimator &) {}
void pubTF(const Estimator &, const std_msgs::Header &) {}

int main(int argc, char **argv) {
  if (argc != 4) {
    std::cerr << "usage: vins_fusion CONFIG.yaml FOLDER OUT.tum" << std::endl;
    return 2;
  }
  cv::setNumThreads(1);
  readParameters(argv[1]);
  const std::string folder = std::string(argv[2]) + "/mav0/";
  const std::vector<ImuRow> imu = read_imu(folder + "imu0/data.csv");
  const auto pairs = taken_together(folder, STEREO ? 2 : 1, TOGETHER_NS);
  if (pairs.empty())
    std::_Exit(1);  // its destructor waits for a thread that has not begun
  estimator.setParameter();
  out.open(argv[3]);
  std::size_t next = 0;
  for (std::size_t i = 0; i < pairs.size(); i++) {
    if (i % std::max<std::size_t>(1, pairs.size() / 10) == 0)
      std::cout << "progress " << i << " of " << pairs.size() << std::endl;
    const ImageRow &row = pairs[i].front();
    const cv::Mat picture = cv::imread(row.path, cv::IMREAD_GRAYSCALE);
    const cv::Mat second = STEREO ? cv::imread(pairs[i].back().path, cv::IMREAD_GRAYSCALE) : cv::Mat();
    if (picture.empty() || (STEREO && second.empty())) {
      std::cerr << row.path << ": not a picture" << std::endl;
      return 1;
    }
    // A measurement at the picture or past it is needed to integrate to it.
    const double time = seconds(row.stamp_ns);
    while (next < imu.size() && (next == 0 || seconds(imu[next - 1].stamp_ns) < time + estimator.td)) {
      const ImuRow &m = imu[next++];
      estimator.inputIMU(seconds(m.stamp_ns), Eigen::Vector3d(m.accel), Eigen::Vector3d(m.gyro));
    }
    if (next == 0 || seconds(imu[next - 1].stamp_ns) < time + estimator.td)
      break;  // it would wait for measurements that do not come
    estimator.inputImage(time, picture, second);
    while (MULTIPLE_THREAD && estimator.inputImageCnt % 2 == 0 && optimised != time)
      std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  out.flush();
  std::cout << written << " poses of " << pairs.size() << " pictures" << std::endl;
  if (written == 0) {
    std::cerr << "VINS-Fusion never initialised" << std::endl;
    std::_Exit(1);
  }
  std::_Exit(0);  // its thread never ends
}
