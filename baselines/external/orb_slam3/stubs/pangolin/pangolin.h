// In place of Pangolin, which draws: the types that declarations of ORB-SLAM3 name.
#pragma once

using GLubyte = unsigned char;

namespace pangolin {
struct OpenGlMatrix {
  double m[16];
};
}  // namespace pangolin
