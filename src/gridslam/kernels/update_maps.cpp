// One scan into many maps: the tiles that it touches become their map's own, then they are written.
#include "update.hpp"

#include <numeric>

namespace gridslam {
namespace {

constexpr int kMostBeamCells = 21000;  // from the base to a beam's end: as `MOST_BEAM_CELLS` in reference_maps.py

// Whether the tables hold whatever the scan can write to, with the pages that `TileMaps._cover` lays out. What is not
// finite is held by none.
bool covers(const Maps& m, const double* poses, int k, double reach_m, double margin_m, double resolution) {
  if (!(reach_m <= kMostBeamCells * resolution * (1 + 1e-9))) return false;
  const double page_m = resolution * kTile * kPage, limit = kFarthest * resolution;
  const double around = reach_m + margin_m - 1e-6;  // rounding must not ask for more than `_cover` gives
  const auto inside = [&](double centre, int first, int count) {
    const double low = centre - around, high = centre + around;
    return low >= -limit && high <= limit && std::floor(low / page_m) >= first &&
           std::floor(high / page_m) < static_cast<double>(first) + count;
  };
  for (int i = 0; i < k; ++i)
    if (!(inside(poses[3 * i], m.page_col0, m.page_cols) && inside(poses[3 * i + 1], m.page_row0, m.page_rows) &&
          std::isfinite(poses[3 * i + 2])))
      return false;
  return true;
}

double reach_of(const Scan& scan) {
  double most = scan.origin[0] * scan.origin[0] + scan.origin[1] * scan.origin[1];
  for (int j = 0; j < scan.b; ++j) {
    const double x = scan.ends[2 * j], y = scan.ends[2 * j + 1], squared = x * x + y * y;
    if (std::isnan(squared)) return squared;
    most = std::max(most, squared);
  }
  return std::sqrt(most);
}

}  // namespace

Insertion::Insertion(const Maps& m, const Arena& ids, const int32_t* rows, const double* poses, int k, const Scan& scan,
                     const Evidence& e, const uint8_t* cone, int reach)
    : arena(ids),
      m_(m),
      rows_(rows, rows + k),
      poses_(poses, poses + 3 * static_cast<ptrdiff_t>(k)),
      scan_(scan),
      e_(e),
      cone_(cone, reach),
      order_(k),
      is_written_(k) {
  std::iota(order_.begin(), order_.end(), 0);
  const auto heading = [&](int i) {  // a NaN, which is refused later, has no order
    const double theta = poses_[3 * static_cast<size_t>(i) + 2];
    return std::isnan(theta) ? 0.0 : theta;
  };
  std::sort(order_.begin(), order_.end(), [&](int a, int b) { return heading(a) < heading(b); });
}

bool Insertion::follow_earlier(const std::vector<Cell>& earlier) {
  TileSet near;
  for (size_t first = 0, last; first < earlier.size(); first = last) {
    for (last = first; last < earlier.size() && earlier[last].row == earlier[first].row;) ++last;
    const int n = static_cast<int>(last - first), row = earlier[first].row;
    tiles_near_cells(&earlier[first], n, cone_.reach, near);
    if (!own_all(row, near)) {
      pending.assign(earlier.begin() + static_cast<ptrdiff_t>(first), earlier.end());
      return false;
    }
    follow(m_, m_.root(row), &earlier[first], n, cone_);
  }
  return true;
}

bool Insertion::is_covered(double margin_m) const {
  return covers(m_, poses_.data(), maps(), reach_of(scan_), margin_m, scan_.resolution);
}

bool Insertion::fits(int64_t room, int threads) const {
  const double side = 2 * reach_of(scan_) / (scan_.resolution * kTile) + 2;
  if (room < 0 || maps() * side * side <= static_cast<double>(room)) return true;
  std::atomic<int64_t> tiles{0};
  parallel_for(maps(), threads, [&](int i) {
    Fan fan;
    TileSet crossed;
    see(i, fan);
    fan.tiles(crossed);
    tiles += crossed.count();
  });
  return tiles <= room;
}

void Insertion::insert(int i) {
  thread_local Fan fan;
  thread_local TileSet tiles;
  thread_local std::vector<Cell> changed;
  const int row = rows_[i];
  see(i, fan);
  fan.tiles(tiles);
  if (!own_all(row, tiles)) return;
  is_written_[i] = true;
  changed.clear();
  add_evidence(m_, row, fan, tiles, e_, changed);
  if (changed.empty()) return;
  const int n = static_cast<int>(changed.size());
  tiles_near_cells(changed.data(), n, cone_.reach, tiles);
  if (own_all(row, tiles)) {
    follow(m_, m_.root(row), changed.data(), n, cone_);
  } else {
    const std::lock_guard lock(ids_);
    pending.insert(pending.end(), changed.begin(), changed.end());
  }
}

void Insertion::see(int i, Fan& fan) const {
  fan.see(Pose(&poses_[3 * static_cast<size_t>(i)]), scan_.ends, scan_.b, scan_.origin, 1.0 / scan_.resolution);
}

// What a map reads and writes afterwards is its own, or read alone: so only this is done by one thread at a time.
bool Insertion::own_all(int row, const TileSet& tiles) {
  const std::lock_guard lock(ids_);
  bool all = true;
  tiles.each([&](int y, int x) { all = all && arena.own(m_, row, y, x); });
  return all;
}

std::vector<int32_t> Insertion::left() const {
  std::vector<int32_t> found;
  for (int i = 0; i < maps(); ++i)
    if (!is_written_[i]) found.push_back(i);
  return found;
}

int update(Insertion& insertion, const std::vector<Cell>& earlier, double margin_m, int64_t room, int threads) {
  if (!insertion.follow_earlier(earlier)) return 0;
  if (!insertion.is_covered(margin_m)) return kOutside;
  if (!insertion.fits(room, threads)) return kNoRoom;
  insertion.run(threads);
  return 0;
}

}  // namespace gridslam
