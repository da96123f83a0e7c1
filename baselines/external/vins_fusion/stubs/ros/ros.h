// In place of ROS: what the estimator's own code names. Messages go to the standard outputs; there are no parameters.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>

namespace ros {

struct Time {
  explicit Time(double seconds = 0) : seconds(seconds) {}
  double toSec() const { return seconds; }
  double seconds;
};

struct NodeHandle {
  template <typename T>
  bool getParam(const std::string &, T &) {
    return false;
  }
  void shutdown() {}
};

}  // namespace ros

#define ROS_DEBUG(...) ((void)0)
#define ROS_DEBUG_STREAM(values) ((void)0)
#define ROS_INFO(...) (std::printf(__VA_ARGS__), std::printf("\n"))
#define ROS_INFO_STREAM(values) (std::cout << values << std::endl)
#define ROS_WARN(...) (std::fprintf(stderr, __VA_ARGS__), std::fprintf(stderr, "\n"))
#define ROS_WARN_STREAM(values) (std::cerr << values << std::endl)
#define ROS_ERROR_STREAM(values) (std::cerr << values << std::endl)
#define ROS_BREAK() std::abort()
#define ROS_ASSERT(condition) ((condition) ? (void)0 : std::abort())
