// Bilinear look-ups in the distance field: value and gradient between the centres of four cells.
#pragma once
#include "maps.hpp"

namespace gridslam {

struct Sample {
  float value, du, dv;  // field in [0, 255] and its derivatives per cell
};

class FieldReader {
 public:
  FieldReader(const Maps& m, int row) : m_(m), root_(m.root(row)) {}

  // (u, v) in cells from the world's origin, along x and y.
  Sample operator()(double u, double v) {
    const double fu = std::floor(u - 0.5), fv = std::floor(v - 0.5);
    const int x = static_cast<int>(fu), y = static_cast<int>(fv);
    const float a = static_cast<float>(u - 0.5 - fu), b = static_cast<float>(v - 0.5 - fv);
    float f00, f01, f10, f11;
    const int ix = x & kTileMask, iy = y & kTileMask;
    if (ix < kTileMask && iy < kTileMask) {
      const uint8_t* p = tile(y >> kTileBits, x >> kTileBits) + (iy << kTileBits) + ix;
      f00 = p[0], f01 = p[1], f10 = p[kTile], f11 = p[kTile + 1];
    } else {
      f00 = m_.field_at(root_, y, x), f01 = m_.field_at(root_, y, x + 1);
      f10 = m_.field_at(root_, y + 1, x), f11 = m_.field_at(root_, y + 1, x + 1);
    }
    const float low = f00 + a * (f01 - f00), high = f10 + a * (f11 - f10);
    return {low + b * (high - low), (1 - b) * (f01 - f00) + b * (f11 - f10), high - low};
  }

 private:
  const uint8_t* tile(int ty, int tx) {
    if (ty != ty_ || tx != tx_) {
      ty_ = ty, tx_ = tx;
      tile_ = m_.field + static_cast<int64_t>(m_.tile(root_, ty, tx)) * kTileCells;
    }
    return tile_;
  }

  const Maps& m_;
  const int32_t* root_;
  int ty_ = std::numeric_limits<int>::min(), tx_ = ty_;
  const uint8_t* tile_ = nullptr;
};

}  // namespace gridslam
