// One scan into many maps: the tiles that it touches become their map's own, then they are written.
#include <memory>

#include "update.hpp"

namespace gridslam {
namespace {

constexpr int kMostBeamCells = 21000;  // from the base to a beam's end: as `MOST_BEAM_CELLS` in reference_maps.py
constexpr int kChunk = 8;              // maps a thread that are written before the next ones are looked at

struct Slot {
  Fan fan;
  TileSet crossed, near;
  std::vector<Cell> changed;
};

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

bool own_all(const Maps& m, Arena& arena, int row, const TileSet& set) {
  bool all = true;
  set.each([&](int ty, int tx) { all = all && arena.own(m, row, ty, tx); });
  return all;
}

}  // namespace

// Inserts the scan into maps `rows`, in order, and lets their fields follow; `pending` are changed cells, grouped by
// row, whose field is still the old one: of the call before when it comes, and of this one when it returns for want of
// free ids. Returns how many of the maps were written; kOutside if the tables do not hold what may be written, kNoRoom
// if more tiles than `room` are crossed: nothing was done then. A negative `room` is not looked at.
int update(const Maps& m, Arena& arena, const int32_t* rows, const double* poses, int k, const Scan& scan,
           const Evidence& e, const uint8_t* cone_cells, int reach, double margin_m, int64_t room, int threads,
           std::vector<Cell>& pending) {
  const double scale = 1.0 / scan.resolution, reach_m = reach_of(scan);
  const Cone cone(cone_cells, reach);
  thread_local std::vector<std::unique_ptr<Slot>> slots;
  const int chunk = std::max(1, std::min(k, threads <= 1 ? 1 : kChunk * threads));
  while (static_cast<int>(slots.size()) < chunk) slots.push_back(std::make_unique<Slot>());
  const auto* slot = slots.data();  // that of this thread, also in others
  const auto find = [&](int i, Slot& s) {
    s.fan.see(Pose(poses + 3 * i), scan.ends, scan.b, scan.origin, scale);
    s.fan.tiles(s.crossed);
  };
  TileSet near;
  for (size_t first = 0, last; first < pending.size(); first = last) {
    for (last = first; last < pending.size() && pending[last].row == pending[first].row;) ++last;
    const int n = static_cast<int>(last - first), row = pending[first].row;
    tiles_near_cells(&pending[first], n, reach, near);
    if (!own_all(m, arena, row, near)) {
      pending.erase(pending.begin(), pending.begin() + static_cast<std::ptrdiff_t>(first));
      return 0;
    }
    follow(m, m.root(row), &pending[first], n, cone);
  }
  pending.clear();
  if (!covers(m, poses, k, reach_m, margin_m, scan.resolution)) return kOutside;
  const double side = 2 * reach_m * scale / kTile + 2;
  if (room >= 0 && k * side * side > static_cast<double>(room)) {
    std::atomic<int64_t> tiles{0};
    parallel_for(k, threads, [&](int i) {
      thread_local Slot s;
      find(i, s);
      tiles.fetch_add(s.crossed.count(), std::memory_order_relaxed);
    });
    if (tiles > room) return kNoRoom;
  }
  for (int first = 0; first < k; first += chunk) {
    const int n = std::min(chunk, k - first);
    parallel_for(n, threads, [&](int i) { find(first + i, *slot[i]); });
    for (int i = 0; i < n; ++i)
      if (!own_all(m, arena, rows[first + i], slot[i]->crossed)) return first;
    parallel_for(n, threads, [&](int i) {
      Slot& s = *slot[i];
      s.changed.clear();
      add_evidence(m, rows[first + i], s.fan, s.crossed, e, s.changed);
      if (!s.changed.empty()) tiles_near_cells(s.changed.data(), static_cast<int>(s.changed.size()), reach, s.near);
    });
    int owned = 0;
    while (owned < n && (slot[owned]->changed.empty() || own_all(m, arena, rows[first + owned], slot[owned]->near)))
      ++owned;
    parallel_for(owned, threads, [&](int i) {
      const auto& cells = slot[i]->changed;
      follow(m, m.root(rows[first + i]), cells.data(), static_cast<int>(cells.size()), cone);
    });
    for (int i = owned; i < n; ++i) pending.insert(pending.end(), slot[i]->changed.begin(), slot[i]->changed.end());
    if (owned < n) return first + n;
  }
  return k;
}

}  // namespace gridslam
