// The parts of an update: evidence for one map, and the field that follows the cells that changed.
#pragma once
#include <mutex>

#include "rays.hpp"
#include "threads.hpp"

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

// A scan that is inserted into maps `rows`, each at most once, by any number of threads together: one that takes a map
// does all of it. The tables must hold whatever may be written, and the scan must be kept.
class Insertion {
 public:
  Arena arena;                // with the ids that are left
  std::vector<Cell> pending;  // changed cells, grouped by row, whose field is still the old one for want of ids

  Insertion(const Maps& m, const Arena& ids, const int32_t* rows, const double* poses, int k, const Scan& scan,
            const Evidence& e, const uint8_t* cone, int reach);
  int maps() const { return static_cast<int>(rows_.size()); }
  // Lets the field follow what was pending before. False, with what is still pending, where the ids do not suffice.
  bool follow_earlier(const std::vector<Cell>& earlier);
  // Whether the tables hold whatever may be written.
  bool is_covered(double margin_m) const;
  // Whether the tiles that the rays cross are not more than `room`, any number where that is negative.
  bool fits(int64_t room, int threads) const;
  // Inserts the scan into all maps.
  void run(int threads) {
    parallel_for(maps(), threads, [this](int i) { insert(order_[static_cast<size_t>(i)]); });
  }
  // Places of the maps that were not written for want of ids.
  std::vector<int32_t> left() const;

 private:
  void insert(int i);
  void see(int i, Fan& fan) const;
  bool own_all(int row, const TileSet& tiles);

  const Maps m_;
  const std::vector<int32_t> rows_;
  const std::vector<double> poses_;
  const Scan scan_;
  const Evidence e_;
  const Cone cone_;
  std::vector<int> order_;  // by heading: the rays of poses that follow each other are often the same
  std::vector<uint8_t> is_written_;
  std::mutex ids_;
};
// Lets fields follow what is pending from a call before, then inserts the scan. Returns 0; or kOutside if the tables do
// not hold what may be written, kNoRoom if more tiles than `room` are crossed: nothing was inserted then.
int update(Insertion& insertion, const std::vector<Cell>& earlier, double margin_m, int64_t room, int threads);

}  // namespace gridslam
