// The binary Bayes filter along the rays of a scan, and the distance field that follows the cells that changed.

#include "maps.hpp"

namespace gridslam {
namespace {

inline int value_or_zero(int16_t v) { return v == kUnknown ? 0 : v; }

// Frees the cells of a line but its last; remembers those that stop being occupied. Walks tile by tile: within one, a
// step is an addition to a pointer.
void free_line(const Maps& m, const int32_t* root, const Line& line, const Evidence& e, int row, std::vector<Cell>& crossed) {
  const bool along_x = std::abs(line.dx) >= std::abs(line.dy);
  const int major_step = (along_x ? line.dx : line.dy) >= 0 ? 1 : -1, minor_step = (along_x ? line.dy : line.dx) >= 0 ? 1 : -1;
  const int twice_minor = 2 * std::abs(along_x ? line.dy : line.dx), twice_n = 2 * line.n;
  const int major_stride = major_step * (along_x ? 1 : kTile), minor_stride = minor_step * (along_x ? kTile : 1);
  // floor((2 i d + n) / (2 n)) of Line steps at a tie for d >= 0 and after it for d < 0: the error starts accordingly.
  int error = minor_step > 0 ? line.n : line.n - 1;
  int major = along_x ? line.x0 : line.y0, minor = along_x ? line.y0 : line.x0;
  for (int left = line.n; left > 0;) {
    const int x = along_x ? major : minor, y = along_x ? minor : major;
    int16_t* cell = m.log_odds + static_cast<int64_t>(m.tile(root, y >> kTileBits, x >> kTileBits)) * kTileCells + Maps::inside(y, x);
    const int major_in = major & kTileMask, minor_in = minor & kTileMask;
    const int run = std::min(left, major_step > 0 ? kTile - major_in : major_in + 1);
    const int turns_allowed = minor_step > 0 ? kTileMask - minor_in : minor_in;
    int turns = 0, i = 0;
    while (i < run && turns <= turns_allowed) {
      const int before = value_or_zero(*cell);
      const int after = std::max(before + e.miss, e.min);
      *cell = static_cast<int16_t>(after);
      if (before > e.occupied_above && after <= e.occupied_above) [[unlikely]] {
        const int u = major + i * major_step, v = minor + turns * minor_step;
        crossed.push_back({row, along_x ? v : u, along_x ? u : v, 0});
      }
      error += twice_minor;
      const int turn = error >= twice_n;
      error -= turn ? twice_n : 0;
      cell += major_stride + (turn ? minor_stride : 0);
      turns += turn;
      ++i;
    }
    major += i * major_step, minor += turns * minor_step, left -= i;
  }
}

struct End {
  int x, y;
  int16_t* cell;
  int16_t before;
};

void update_one(const Maps& m, int row, const Pose& pose, const double* ends, int b, const double* origin, double scale, const Evidence& e,
                std::vector<Cell>& changed) {
  const int32_t* root = m.root(row);
  const int ox = cell_of(pose.world_x(origin), scale), oy = cell_of(pose.world_y(origin), scale);
  std::vector<End> hits(b);
  for (int j = 0; j < b; ++j) {
    End& h = hits[j];
    h.x = cell_of(pose.world_x(ends + 2 * j), scale), h.y = cell_of(pose.world_y(ends + 2 * j), scale);
    const int64_t tile = m.tile(root, h.y >> kTileBits, h.x >> kTileBits);
    h.cell = m.log_odds + tile * kTileCells + Maps::inside(h.y, h.x);
    h.before = *h.cell;
  }
  std::vector<Cell> crossed;
  for (const End& h : hits) free_line(m, root, Line(ox, oy, h.x, h.y), e, row, crossed);
  for (const End& h : hits) *h.cell = h.before;  // an end cell of this scan is not freed by it
  for (const End& h : hits) {
    const int before = value_or_zero(*h.cell);
    const int after = std::min(before + e.hit, e.max);
    *h.cell = static_cast<int16_t>(after);
    if (before <= e.occupied_above && after > e.occupied_above) changed.push_back({row, h.y, h.x, 1});
  }
  for (const Cell& c : crossed) {
    const int64_t tile = m.tile(root, c.y >> kTileBits, c.x >> kTileBits);
    if (value_or_zero(m.log_odds[tile * kTileCells + Maps::inside(c.y, c.x)]) <= e.occupied_above) changed.push_back(c);
  }
}

// A newly occupied cell's cone, as a maximum over what is there.
void stamp(const Maps& m, const int32_t* root, int cy, int cx, const uint8_t* cone, int reach) {
  const int side = 2 * reach + 1, y0 = cy - reach, y1 = cy + reach, x0 = cx - reach, x1 = cx + reach;
  for (int xs = x0; xs <= x1;) {
    const int xe = std::min(x1, xs | kTileMask);
    for (int ys = y0; ys <= y1;) {
      const int ye = std::min(y1, ys | kTileMask);
      uint8_t* tile = m.field + static_cast<int64_t>(m.tile(root, ys >> kTileBits, xs >> kTileBits)) * kTileCells;
      for (int y = ys; y <= ye; ++y) {
        uint8_t* to = tile + Maps::inside(y, xs);
        const uint8_t* from = cone + (y - cy + reach) * side + (xs - cx + reach);
        for (int x = 0; x <= xe - xs; ++x) to[x] = std::max(to[x], from[x]);
      }
      ys = ye + 1;
    }
    xs = xe + 1;
  }
}

// Occupied cells of the window, read off the field; `list` is reused.
void find_occupied(const Maps& m, const int32_t* root, int y0, int y1, int x0, int x1, std::vector<std::array<int, 2>>& list) {
  list.clear();
  for (int xs = x0; xs <= x1; xs = (xs | kTileMask) + 1) {
    const int xe = std::min(x1, xs | kTileMask);
    for (int ys = y0; ys <= y1; ys = (ys | kTileMask) + 1) {
      const int ye = std::min(y1, ys | kTileMask);
      const int64_t tile = m.tile(root, ys >> kTileBits, xs >> kTileBits);
      if (tile == 0) continue;
      for (int y = ys; y <= ye; ++y) {
        const uint8_t* row = m.field + tile * kTileCells + Maps::inside(y, xs);
        uint8_t greatest = 0;
        for (int x = 0; x <= xe - xs; ++x) greatest = std::max(greatest, row[x]);
        if (greatest != kOccupiedField) continue;
        for (int x = 0; x <= xe - xs; ++x)
          if (row[x] == kOccupiedField) list.push_back({y, xs + x});
      }
    }
  }
}

// Mends the field around a cell that is no longer occupied: only where that cell was the nearest obstacle.
void rebuild(const Maps& m, const int32_t* root, int cy, int cx, const uint8_t* cone, int reach, std::vector<std::array<int, 2>>& list) {
  find_occupied(m, root, cy - 2 * reach, cy + 2 * reach, cx - 2 * reach, cx + 2 * reach, list);
  const int side = 2 * reach + 1;
  for (int dy = -reach; dy <= reach; ++dy)
    for (int dx = -reach; dx <= reach; ++dx) {
      const uint8_t was = cone[(dy + reach) * side + dx + reach];
      if (was == 0) continue;
      const int y = cy + dy, x = cx + dx;
      uint8_t& value = m.field[static_cast<int64_t>(m.tile(root, y >> kTileBits, x >> kTileBits)) * kTileCells + Maps::inside(y, x)];
      if (value != was && (dy != 0 || dx != 0)) continue;
      uint8_t nearest = 0;
      for (const auto& [oy, ox] : list) {
        const int ey = y - oy + reach, ex = x - ox + reach;
        if (static_cast<unsigned>(ey) < static_cast<unsigned>(side) && static_cast<unsigned>(ex) < static_cast<unsigned>(side))
          nearest = std::max(nearest, cone[ey * side + ex]);
      }
      value = nearest;
    }
}

}  // namespace

void update_log_odds(const Maps& m, const int32_t* rows, const double* poses, int k, const double* ends, int b, const double* origin,
                     double resolution, const Evidence& e, int threads, std::vector<Cell>& changed) {
  std::vector<std::vector<Cell>> found(k);
  parallel_for(k, threads, [&](int i) { update_one(m, rows[i], Pose(poses + 3 * i), ends, b, origin, 1.0 / resolution, e, found[i]); });
  for (const auto& part : found) changed.insert(changed.end(), part.begin(), part.end());
}

void update_field(const Maps& m, const Cell* cells, int n, const uint8_t* cone, int reach, int threads) {
  std::vector<int> starts;  // cells come grouped by row
  for (int i = 0; i < n; ++i)
    if (i == 0 || cells[i].row != cells[i - 1].row) starts.push_back(i);
  starts.push_back(n);
  parallel_for(static_cast<int>(starts.size()) - 1, threads, [&](int g) {
    const int32_t* root = m.root(cells[starts[g]].row);
    std::vector<std::array<int, 2>> list;
    for (int i = starts[g]; i < starts[g + 1]; ++i) {
      const Cell& c = cells[i];
      if (c.occupied)
        stamp(m, root, c.y, c.x, cone, reach);
      else  // no cell's nearest obstacle is found at it from now on
        m.field[static_cast<int64_t>(m.tile(root, c.y >> kTileBits, c.x >> kTileBits)) * kTileCells + Maps::inside(c.y, c.x)] = 0;
    }
    for (int i = starts[g]; i < starts[g + 1]; ++i)
      if (!cells[i].occupied) rebuild(m, root, cells[i].y, cells[i].x, cone, reach, list);
  });
}

}  // namespace gridslam
