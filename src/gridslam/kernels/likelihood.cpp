// Weighing many poses by one scan in one and the same map: the sum of a field over the ends of the beams.

#include "field.hpp"

namespace gridslam {
namespace {

// The field, 0 to 255, bilinearly interpolated at the ends of all beams, seen from a pose in cells from the centre of
// the field's first cell. Each cell holds its own value and those of its neighbours, so that a look-up is one load.
GRIDSLAM_VERSIONS double sum_at(const uint32_t* patches, int rows, int cols, float x, float y, float c, float s,
                                const Ends& ends) {
  const float last_x = std::nextafter(static_cast<float>(cols), 0.0f),
              last_y = std::nextafter(static_cast<float>(rows), 0.0f);
  float sums[kLanes] = {};  // lane by lane in a fixed order: identical results for any instruction set
  for (int block = 0; block < ends.blocks; ++block) {
    const float *ex = ends.x.data() + block * kLanes, *ey = ends.y.data() + block * kLanes;
    int at[kLanes];
    float a[kLanes], b[kLanes];
    uint32_t patch[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      const float u = std::min(std::max(0.0f, x + (c * ex[l] - s * ey[l])), last_x);  // a NaN becomes 0
      const float v = std::min(std::max(0.0f, y + (s * ex[l] + c * ey[l])), last_y);
      const int iu = static_cast<int>(u), iv = static_cast<int>(v);
      a[l] = u - static_cast<float>(iu), b[l] = v - static_cast<float>(iv);
      at[l] = iv * cols + iu;
    }
    for (int l = 0; l < kLanes; ++l) patch[l] = patches[at[l]];
    float value[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      const int p = static_cast<int>(patch[l]);
      const float f00 = static_cast<float>(p & 255), f01 = static_cast<float>((p >> 8) & 255);
      const float f10 = static_cast<float>((p >> 16) & 255), f11 = static_cast<float>((p >> 24) & 255);
      const float low = f00 + a[l] * (f01 - f00), high = f10 + a[l] * (f11 - f10);
      value[l] = low + b[l] * (high - low);
    }
    const int filled = std::min(kLanes, ends.n - block * kLanes);
    for (int l = filled; l < kLanes; ++l) value[l] = 0.0f;
    for (int l = 0; l < kLanes; ++l) sums[l] += value[l];
  }
  double sum = 0;
  for (const float lane : sums) sum += lane;
  return sum;
}

}  // namespace

void sum_at_ends(const uint32_t* patches, int rows, int cols, const double* corner, double resolution,
                 const double* poses, int k, const double* ends, int b, int threads, double* out) {
  const double scale = 1.0 / resolution;
  const Ends in_cells(ends, b, scale);
  parallel_for(k, threads, [&](int i) {
    const double *p = poses + 3 * i, x = (p[0] - corner[0]) * scale - 0.5, y = (p[1] - corner[1]) * scale - 0.5;
    out[i] = sum_at(patches, rows, cols, static_cast<float>(x), static_cast<float>(y),
                    static_cast<float>(std::cos(p[2])), static_cast<float>(std::sin(p[2])), in_cells);
  });
}

}  // namespace gridslam
