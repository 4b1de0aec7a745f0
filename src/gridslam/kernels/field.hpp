// Bilinear look-ups in the distance field: value and gradient between the centres of four cells.
#pragma once
#include "maps.hpp"

namespace gridslam {

// Values of the field at the centres of four neighbouring cells, for a block of points at once.
constexpr int kLanes = 8;
struct Corners {
  float f00[kLanes], f01[kLanes], f10[kLanes], f11[kLanes];  // at (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)
};

GRIDSLAM_INLINE void gather(const Maps& m, const int32_t* root, const int* x, const int* y, Corners& out) {
  for (int l = 0; l < kLanes; ++l) {
    const int ix = x[l] & kTileMask, iy = y[l] & kTileMask;
    if (ix < kTileMask && iy < kTileMask) {
      const uint8_t* p = m.field +
                         static_cast<int64_t>(m.tile(root, y[l] >> kTileBits, x[l] >> kTileBits)) * kTileCells +
                         (iy << kTileBits) + ix;
      out.f00[l] = p[0], out.f01[l] = p[1], out.f10[l] = p[kTile], out.f11[l] = p[kTile + 1];
    } else {
      out.f00[l] = m.field_at(root, y[l], x[l]), out.f01[l] = m.field_at(root, y[l], x[l] + 1);
      out.f10[l] = m.field_at(root, y[l] + 1, x[l]), out.f11[l] = m.field_at(root, y[l] + 1, x[l] + 1);
    }
  }
}

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

// Bilinear interpolation between the centres of cells, at the ends seen from one pose. The pose's whole cells are kept
// apart as integers, so single precision resolves 1e-4 of a cell at any distance from the world's origin.
struct Block {
  float rx[kLanes], ry[kLanes];                 // from the pose to the end, world axes, cells
  float value[kLanes], du[kLanes], dv[kLanes];  // field in [0, 255] and its derivatives per cell
  int x[kLanes], y[kLanes];                     // the cell that holds the end
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

GRIDSLAM_INLINE void interpolate(const Maps& m, const int32_t* root, const CellPose& pose, const Ends& ends, int block,
                                 Block& out) {
  const float *ex = ends.x.data() + block * kLanes, *ey = ends.y.data() + block * kLanes;
  int x[kLanes], y[kLanes];
  float a[kLanes], b[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    out.rx[l] = pose.c * ex[l] - pose.s * ey[l];
    out.ry[l] = pose.s * ex[l] + pose.c * ey[l];
    const float u = pose.fx + out.rx[l], v = pose.fy + out.ry[l];
    const int iu = static_cast<int>(u), iv = static_cast<int>(v);
    const int fu = iu - (u < static_cast<float>(iu)), fv = iv - (v < static_cast<float>(iv));
    a[l] = u - static_cast<float>(fu), b[l] = v - static_cast<float>(fv);
    x[l] = pose.x + fu, y[l] = pose.y + fv;
  }
  Corners f;
  gather(m, root, x, y, f);
  for (int l = 0; l < kLanes; ++l) out.x[l] = x[l] + (a[l] >= 0.5f), out.y[l] = y[l] + (b[l] >= 0.5f);
  for (int l = 0; l < kLanes; ++l) {
    const float dx0 = f.f01[l] - f.f00[l], dx1 = f.f11[l] - f.f10[l];
    const float low = f.f00[l] + a[l] * dx0, high = f.f10[l] + a[l] * dx1;
    out.value[l] = low + b[l] * (high - low);
    out.du[l] = dx0 + b[l] * (dx1 - dx0);
    out.dv[l] = high - low;
  }
}

}  // namespace gridslam
