// A program that reads a folder in EuRoC layout and writes TUM poses of the IMU: ./my_slam EUROC_FOLDER OUT
// It turns with the gyroscope, levels itself by gravity once, and integrates the accelerations, with the drag of water.
#include <cmath>
#include <cstdio>
#include <string>

struct Vector { double x, y, z; };
struct Quaternion { double w, x, y, z; };

Quaternion product(const Quaternion &a, const Quaternion &b) {
  return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

Vector rotate(const Quaternion &q, const Vector &v) {
  const Quaternion r = product(product(q, {0, v.x, v.y, v.z}), {q.w, -q.x, -q.y, -q.z});
  return {r.x, r.y, r.z};
}

Quaternion from_rotation(const Vector &r) {  // an angle in rad along its axis
  const double angle = std::sqrt(r.x * r.x + r.y * r.y + r.z * r.z), s = angle > 0 ? std::sin(angle / 2) / angle : 0.5;
  return {std::cos(angle / 2), s * r.x, s * r.y, s * r.z};
}

Quaternion level(const Vector &up) {  // takes a measured upward direction to +z
  const double n = std::sqrt(up.x * up.x + up.y * up.y + up.z * up.z), angle = std::acos(up.z / n);
  const double across = std::hypot(up.x, up.y);
  return across > 0 ? from_rotation({angle * up.y / across, -angle * up.x / across, 0}) : Quaternion{1, 0, 0, 0};
}

int main(int argc, char **argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: my_slam EUROC_FOLDER OUT\n"), 2;
  const std::string path = std::string(argv[1]) + "/mav0/imu0/data.csv";
  std::FILE *in = std::fopen(path.c_str(), "r"), *out = std::fopen(argv[2], "w");
  if (!in || !out) return std::fprintf(stderr, "cannot open %s or %s\n", path.c_str(), argv[2]), 1;
  const double gravity = 9.81, drag_s = 3.0;
  char line[512];
  long long stamp, before = 0;
  Vector w, a, velocity{0, 0, 0}, position{0, 0, 0};
  Quaternion attitude{1, 0, 0, 0};
  while (std::fgets(line, sizeof line, in)) {
    if (std::sscanf(line, "%lld,%lf,%lf,%lf,%lf,%lf,%lf", &stamp, &w.x, &w.y, &w.z, &a.x, &a.y, &a.z) != 7) continue;
    if (!before) attitude = level(a), before = stamp;
    const double dt = 1e-9 * (stamp - before), slows = std::exp(-dt / drag_s);
    before = stamp;
    attitude = product(attitude, from_rotation({w.x * dt, w.y * dt, w.z * dt}));
    const Vector f = rotate(attitude, a);
    velocity = {slows * (velocity.x + f.x * dt), slows * (velocity.y + f.y * dt), slows * (velocity.z + (f.z - gravity) * dt)};
    position = {position.x + velocity.x * dt, position.y + velocity.y * dt, position.z + velocity.z * dt};
    std::fprintf(out, "%lld.%09lld %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", stamp / 1000000000, stamp % 1000000000,
                 position.x, position.y, position.z, attitude.x, attitude.y, attitude.z, attitude.w);
  }
  return std::fclose(out) ? 1 : 0;
}
