// The parts of an update: evidence for one map, and the field that follows the cells that changed.
#pragma once
#include "rays.hpp"

namespace gridslam {

// The cone of an obstacle in a frame of zeros, so that any row of it can be laid over a tile's whole row.
class Cone {
 public:
  const int reach;
  Cone(const uint8_t* cone, int r)
      : reach(r), width_(2 * kTile + 2 * r + 1), rows_(static_cast<size_t>(2 * r + 1) * width_, 0) {
    for (int y = -r; y <= r; ++y)
      std::copy_n(cone + (y + r) * (2 * r + 1), 2 * r + 1, rows_.data() + (y + r) * width_ + kTile);
    for (int y = 0; y <= r; ++y)
      for (int x = 0; x <= r; ++x) by_square_[y * y + x * x] = cone[(y + r) * (2 * r + 1) + x + r];
  }
  // Over cells x, x + 1, ... of row y, as seen from the obstacle.
  const uint8_t* over(int y, int x) const { return rows_.data() + (y + reach) * width_ + x + reach + kTile; }
  // At this squared distance in cells from the obstacle.
  uint8_t at(int squared) const { return squared <= 2 * reach * reach ? by_square_[squared] : uint8_t{0}; }

 private:
  int width_;
  std::vector<uint8_t> rows_;
  uint8_t by_square_[2 * kTile * kTile] = {};
};

// Adds a scan's evidence to the map `row`, whose `tiles` are writable; the cells that became occupied or free, while
// their field is still the old one, go to `changed`.
void add_evidence(const Maps& m, int row, const Fan& fan, const TileSet& tiles, const Evidence& e,
                  std::vector<Cell>& changed);
// Lets the field of one map follow n changed cells.
void follow(const Maps& m, const int32_t* root, const Cell* cells, int n, const Cone& cone);

}  // namespace gridslam
