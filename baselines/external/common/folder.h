// Reads the rows of an EuRoC folder; shared by the drivers.

#pragma once

#include <cstdint>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

struct ImuRow {
  int64_t stamp_ns;
  double gyro[3], accel[3];  // rad/s, m/s^2
};

struct ImageRow {
  int64_t stamp_ns;
  std::string path;
};

inline double seconds(int64_t stamp_ns) { return double(stamp_ns) * 1e-9; }

inline std::vector<std::vector<std::string>> read_rows(const std::string &path) {
  std::vector<std::vector<std::string>> rows;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (!line.empty() && line.back() == '\r')
      line.pop_back();
    if (line.empty() || line[0] == '#')
      continue;
    std::vector<std::string> fields;
    std::istringstream text(line);
    for (std::string field; std::getline(text, field, ',');)
      fields.push_back(field);
    rows.push_back(fields);
  }
  return rows;
}

inline std::vector<ImuRow> read_imu(const std::string &path) {
  std::vector<ImuRow> found;
  for (const auto &row : read_rows(path)) {
    ImuRow one{};
    one.stamp_ns = std::stoll(row.at(0));
    for (int i = 0; i < 3; i++) {
      one.gyro[i] = std::stod(row.at(1 + i));
      one.accel[i] = std::stod(row.at(4 + i));
    }
    found.push_back(one);
  }
  return found;
}

inline std::vector<ImageRow> read_images(const std::string &camera) {
  std::vector<ImageRow> found;
  for (const auto &row : read_rows(camera + "/data.csv"))
    found.push_back({std::stoll(row.at(0)), camera + "/data/" + row.at(1)});
  return found;
}

// A line at every tenth of the pictures, which whoever runs the program shows.
inline void tell_progress(std::size_t done, std::size_t total) {
  if (total > 0 && done * 10 / total != (done + 1) * 10 / total)
    std::cout << "progress " << done + 1 << " of " << total << std::endl;
}
