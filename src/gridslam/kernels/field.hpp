// Bilinear look-ups in the distance field: value and gradient between the centres of four cells.
#pragma once
#include "maps.hpp"

namespace gridslam {

constexpr int kLanes = 8;

// End points in cells, in blocks of kLanes; the last block is filled up with points that count nothing.
struct Ends {
  int n, blocks;
  std::vector<float> x, y;
  Ends(const double* ends, int b, double scale)
      : n(b), blocks((b + kLanes - 1) / kLanes), x(blocks * kLanes, 0.0f), y(x) {
    for (int j = 0; j < b; ++j) {
      x[j] = static_cast<float>(bounded(ends[2 * j] * scale, kMost));
      y[j] = static_cast<float>(bounded(ends[2 * j + 1] * scale, kMost));
    }
  }

 private:
  static constexpr double kMost = kFarthest / 4;  // seen from any pose, the sum fits an integer
};

struct CellPose {
  int x = kFarthest, y = kFarthest;  // where nothing is mapped: what a pose beyond, or one of NaN, sees
  float fx = 0, fy = 0, c = 1, s = 0;
  CellPose(double px, double py, double theta) {
    if (!(std::abs(px) <= kFarthest && std::abs(py) <= kFarthest && std::isfinite(theta))) return;
    x = static_cast<int>(std::floor(px)), y = static_cast<int>(std::floor(py));
    fx = static_cast<float>(px - x - 0.5), fy = static_cast<float>(py - y - 0.5);
    c = static_cast<float>(std::cos(theta)), s = static_cast<float>(std::sin(theta));
  }
};

// The ends seen from one pose, in blocks of kLanes: where they lie between the centres of four cells, and the field
// there. The pose's whole cells are kept apart as integers, so single precision resolves 1e-4 of a cell at any distance
// from the world's origin.
struct View {
  std::vector<float> rx, ry;      // from the pose to the end, world axes, cells
  std::vector<float> a, b;        // from the centre of the lower left of the four cells, in [0, 1)
  std::vector<int32_t> x, y;      // that cell
  std::vector<uint32_t> corners;  // field at (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1), the first lowest
  void of(const Maps& m, const int32_t* root, const CellPose& pose, const Ends& ends);
  int end_x(int j) const { return x[j] + (a[j] >= 0.5f); }  // the cell that holds the end
  int end_y(int j) const { return y[j] + (b[j] >= 0.5f); }
};

// Field in [0, 255] by bilinear interpolation, and its derivatives per cell.
struct Value {
  float value, du, dv;
};

GRIDSLAM_INLINE Value interpolate(uint32_t corners, float a, float b) {
  const float f00 = static_cast<float>(static_cast<int>(corners & 255)),
              f01 = static_cast<float>(static_cast<int>(corners >> 8 & 255)),
              f10 = static_cast<float>(static_cast<int>(corners >> 16 & 255)),
              f11 = static_cast<float>(static_cast<int>(corners >> 24));
  const float dx0 = f01 - f00, dx1 = f11 - f10;
  const float low = f00 + a * dx0, high = f10 + a * dx1;
  return {low + b * (high - low), dx0 + b * (dx1 - dx0), high - low};
}

}  // namespace gridslam
