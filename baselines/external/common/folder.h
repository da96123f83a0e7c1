// Reads the rows of an EuRoC folder; shared by the drivers.

#pragma once

#include <cstdint>
#include <cstdlib>
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

// Pictures that the cameras cam0, cam1, ... of a folder took together: a row of each, those of the others being the
// nearest to that of cam0, and at most tolerance_ns from it. Where there are none at all, it says so.
inline std::vector<std::vector<ImageRow>> taken_together(const std::string &folder, std::size_t cameras,
                                                         int64_t tolerance_ns = 1'000'000) {
  std::vector<std::vector<ImageRow>> images, found;
  for (std::size_t i = 0; i < cameras; i++)
    images.push_back(read_images(folder + "cam" + std::to_string(i)));
  std::vector<std::size_t> at(cameras, 0);
  for (std::size_t k = 0; cameras > 0 && k < images[0].size(); k++) {
    std::vector<ImageRow> together = {images[0][k]};
    for (std::size_t i = 1; i < cameras; i++) {
      const auto apart = [&](std::size_t n) { return std::llabs(images[i][n].stamp_ns - images[0][k].stamp_ns); };
      while (at[i] + 1 < images[i].size() && apart(at[i] + 1) <= apart(at[i]))
        at[i]++;
      if (at[i] >= images[i].size() || apart(at[i]) > tolerance_ns)
        continue;
      // One whose partner was lost takes no neighbour's: of faster cameras, that one is within the tolerance, too.
      const auto other = [&](std::size_t n) {
        return std::llabs(images[i][at[i]].stamp_ns - images[0][n].stamp_ns);
      };
      if ((k == 0 || other(k - 1) > apart(at[i])) && (k + 1 == images[0].size() || other(k + 1) >= apart(at[i])))
        together.push_back(images[i][at[i]]);
    }
    if (together.size() == cameras)  // a pair needs both
      found.push_back(together);
  }
  if (found.empty() && cameras > 1 && !images[0].empty())
    std::cerr << folder << ": no two pictures taken together: expected stamps of cam0 and cam1 within "
              << double(tolerance_ns) * 1e-6 << " ms of each other; correct them" << std::endl;
  else if (found.empty())
    std::cerr << folder << ": no pictures" << std::endl;
  return found;
}

// A line at every tenth of the pictures, which whoever runs the program shows.
inline void tell_progress(std::size_t done, std::size_t total) {
  if (total > 0 && done * 10 / total != (done + 1) * 10 / total)
    std::cout << "progress " << done + 1 << " of " << total << std::endl;
}
