// Feeds an EuRoC folder to OpenVINS in the order of the stamps, and writes the pose after each update.
//
//   openvins CONFIG.yaml FOLDER OUT.tum
//
// Poses are T_world_imu, gravity along -z; their stamps are of the clock of the IMU. Nothing is left out where the
// machine is slow: each picture is tracked before the next is read.

#include <fstream>
#include <iomanip>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/opencv.hpp>

#include "core/VioManager.h"
#include "core/VioManagerOptions.h"
#include "folder.h"
#include "state/State.h"
#include "utils/opencv_yaml_parse.h"
#include "utils/print.h"
#include "utils/sensor_data.h"

int main(int argc, char **argv) {
  if (argc != 4) {
    std::cerr << "usage: openvins CONFIG.yaml FOLDER OUT.tum" << std::endl;
    return 2;
  }
  auto parser = std::make_shared<ov_core::YamlParser>(argv[1]);
  std::string verbosity = "INFO";
  parser->parse_config("verbosity", verbosity);
  ov_core::Printer::setPrintLevel(verbosity);
  ov_msckf::VioManagerOptions options;
  options.print_and_load(parser);
  if (!parser->successful()) {
    std::cerr << argv[1] << ": OpenVINS could not read all that it needs" << std::endl;
    return 1;
  }
  options.use_multi_threading_subs = false;  // initialises in the thread that feeds it: load changes nothing
  options.num_opencv_threads = 0;            // tracks are the same on every run
  ov_msckf::VioManager system(options);

  const std::string folder = std::string(argv[2]) + "/mav0/";
  const std::vector<ImuRow> imu = read_imu(folder + "imu0/data.csv");
  const auto pairs = taken_together(folder, std::size_t(options.state_options.num_cameras));
  if (pairs.empty())
    return 1;
  if (imu.empty()) {
    std::cerr << folder << ": no inertial measurements" << std::endl;
    return 1;
  }

  std::ofstream out(argv[3]);
  out << std::fixed;
  std::size_t next = 0;
  long written = 0;
  double last = -1;
  for (const auto &rows : pairs) {
    ov_core::CameraData pictures;
    pictures.timestamp = seconds(rows[0].stamp_ns);
    for (std::size_t i = 0; i < rows.size(); i++) {
      cv::Mat picture = cv::imread(rows[i].path, cv::IMREAD_GRAYSCALE);
      if (picture.empty()) {
        std::cerr << rows[i].path << ": not a picture" << std::endl;
        return 1;
      }
      pictures.sensor_ids.push_back(int(i));
      pictures.images.push_back(picture);
      pictures.masks.push_back(cv::Mat::zeros(picture.rows, picture.cols, CV_8UC1));
    }
    // One measurement past the picture is needed to propagate to it.
    const double offset = system.get_state()->_calib_dt_CAMtoIMU->value()(0);
    while (next < imu.size()) {
      const double stamp = seconds(imu[next].stamp_ns);
      ov_core::ImuData message;
      message.timestamp = stamp;
      message.wm = Eigen::Vector3d(imu[next].gyro);
      message.am = Eigen::Vector3d(imu[next].accel);
      system.feed_measurement_imu(message);
      next++;
      if (stamp > pictures.timestamp + offset + 0.005)
        break;
    }
    system.feed_measurement_camera(pictures);
    tell_progress(&rows - pairs.data(), pairs.size());
    if (!system.initialized())
      continue;
    const auto state = system.get_state();
    if (state->_timestamp == last)
      continue;
    last = state->_timestamp;
    const Eigen::Vector3d position = state->_imu->pos();
    const Eigen::Vector4d q = state->_imu->quat();  // JPL's of world to IMU has the numbers of Hamilton's of IMU to world
    out << std::setprecision(9) << last + state->_calib_dt_CAMtoIMU->value()(0) << std::setprecision(7);
    for (double value : {position(0), position(1), position(2), q(0), q(1), q(2), q(3)})
      out << ' ' << value;
    out << '\n';
    written++;
  }
  std::cout << written << " poses of " << pairs.size() << " pictures" << std::endl;
  if (written == 0) {
    std::cerr << "OpenVINS never initialised" << std::endl;
    return 1;
  }
  return 0;
}
