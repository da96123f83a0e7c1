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
  std::vector<std::vector<ImageRow>> images;
  for (int i = 0; i < options.state_options.num_cameras; i++)
    images.push_back(read_images(folder + "cam" + std::to_string(i)));
  if (imu.empty() || images.empty() || images[0].empty()) {
    std::cerr << folder << ": no pictures, or no inertial measurements" << std::endl;
    return 1;
  }

  std::ofstream out(argv[3]);
  out << std::fixed;
  std::size_t next = 0;
  std::vector<std::size_t> others(images.size(), 0);
  long written = 0;
  double last = -1;
  for (const ImageRow &first : images[0]) {
    ov_core::CameraData pictures;
    pictures.timestamp = seconds(first.stamp_ns);
    for (std::size_t i = 0; i < images.size(); i++) {
      while (others[i] < images[i].size() && images[i][others[i]].stamp_ns < first.stamp_ns)
        others[i]++;
      if (others[i] == images[i].size() || images[i][others[i]].stamp_ns != first.stamp_ns)
        continue;
      cv::Mat picture = cv::imread(images[i][others[i]].path, cv::IMREAD_GRAYSCALE);
      if (picture.empty()) {
        std::cerr << images[i][others[i]].path << ": not a picture" << std::endl;
        return 1;
      }
      pictures.sensor_ids.push_back(int(i));
      pictures.images.push_back(picture);
      pictures.masks.push_back(cv::Mat::zeros(picture.rows, picture.cols, CV_8UC1));
    }
    if (pictures.images.size() != images.size())
      continue;  // a pair needs both
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
    tell_progress(&first - images[0].data(), images[0].size());
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
  std::cout << written << " poses of " << images[0].size() << " pictures" << std::endl;
  if (written == 0) {
    std::cerr << "OpenVINS never initialised" << std::endl;
    return 1;
  }
  return 0;
}
