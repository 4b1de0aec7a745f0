// The binary Bayes filter along the rays of a scan, and the distance field that follows the cells that changed.

#include "maps.hpp"

namespace gridslam {
namespace {

inline int value_or_zero(int16_t v) { return v == kUnknown ? 0 : v; }

// Frees cells i in [first, n) of a line within one tile, up to and including the first that stops being occupied: returns
// its i, or n. `aside` is the minor axis as a 32.32 fixed point number, so that no cell waits for the one before it.
int free_run(int16_t* cells, int first, int n, int major_stride, int minor_stride, uint64_t& aside, uint64_t slope, int miss, int least,
             int occupied) {
  uint64_t a = aside;
  int i = first;
  for (; i < n; ++i) {
    int16_t& cell = cells[i * major_stride + static_cast<int>(a >> 32) * minor_stride];
    const int before = value_or_zero(cell), after = std::max(before + miss, least);
    cell = static_cast<int16_t>(after);
    a += slope;
    if (before > occupied && after <= occupied) break;
  }
  aside = a;
  return i;
}

// Frees the cells of a line but its last, tile by tile; remembers those that stop being occupied. The start of the fixed
// point is biased by more than the slope's rounding adds up to, and by far less than what tells two cells apart: ties go
// up for d >= 0 and down for d < 0, as in Line.
void free_line(const Maps& m, const int32_t* root, const Line& line, const Evidence& e, int row, std::vector<Cell>& crossed) {
  if (line.n == 0) return;
  const bool along_x = std::abs(line.dx) >= std::abs(line.dy);
  const int major_step = (along_x ? line.dx : line.dy) >= 0 ? 1 : -1, minor_step = (along_x ? line.dy : line.dx) >= 0 ? 1 : -1;
  const int major_stride = major_step * (along_x ? 1 : kTile), minor_stride = minor_step * (along_x ? kTile : 1);
  const uint64_t slope = (static_cast<uint64_t>(std::abs(along_x ? line.dy : line.dx)) << 32) / line.n;
  uint64_t aside = (1ull << 31) + (minor_step > 0 ? line.n : -1);
  int major = along_x ? line.x0 : line.y0, minor = along_x ? line.y0 : line.x0;
  for (int left = line.n; left > 0;) {
    const int x = along_x ? major : minor, y = along_x ? minor : major;
    int16_t* cells = m.log_odds + static_cast<int64_t>(m.tile(root, y >> kTileBits, x >> kTileBits)) * kTileCells + Maps::inside(y, x);
    const int major_in = major & kTileMask, minor_in = minor & kTileMask;
    int run = std::min(left, major_step > 0 ? kTile - major_in : major_in + 1);
    const uint64_t edge = static_cast<uint64_t>(minor_step > 0 ? kTile - minor_in : minor_in + 1) << 32;
    if (aside + run * slope > edge) run = static_cast<int>((edge - aside - 1) / slope) + 1;
    for (int i = 0; i < run; ++i) {
      i = free_run(cells, i, run, major_stride, minor_stride, aside, slope, e.miss, e.min, e.occupied_above);
      if (i == run) break;
      const int u = major + i * major_step, v = minor + static_cast<int>((aside - slope) >> 32) * minor_step;
      crossed.push_back({row, along_x ? v : u, along_x ? u : v, 0});
    }
    major += run * major_step, minor += static_cast<int>(aside >> 32) * minor_step, left -= run;
    aside &= 0xffffffffull;
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

// Calls visit(offset of the first cell, y, first x, last x) for the rows of a window, cut at tiles; the empty tile is left out.
template <class Visit>
void window_rows(const Maps& m, const int32_t* root, int y0, int y1, int x0, int x1, const Visit& visit) {
  for (int xs = x0; xs <= x1; xs = (xs | kTileMask) + 1) {
    const int xe = std::min(x1, xs | kTileMask);
    for (int ys = y0; ys <= y1; ys = (ys | kTileMask) + 1) {
      const int ye = std::min(y1, ys | kTileMask);
      const int64_t tile = m.tile(root, ys >> kTileBits, xs >> kTileBits);
      if (tile == 0) continue;
      for (int y = ys; y <= ye; ++y) visit(tile * kTileCells + Maps::inside(y, xs), y, xs, xe);
    }
  }
}

// A newly occupied cell's cone, as a maximum over what is there.
void stamp(const Maps& m, const int32_t* root, int cy, int cx, const uint8_t* cone, int reach) {
  window_rows(m, root, cy - reach, cy + reach, cx - reach, cx + reach, [&](int64_t first, int y, int xs, int xe) {
    uint8_t* to = m.field + first;
    const uint8_t* from = cone + (y - cy + reach) * (2 * reach + 1) + xs - cx + reach;
    for (int x = 0; x <= xe - xs; ++x) to[x] = std::max(to[x], from[x]);
  });
}

struct Obstacles {  // relative to some cell, near enough for squares in 16 bits
  std::vector<int16_t> y, x;
};

// Occupied cells of the window of this half width around a cell, read off the field.
void find_occupied(const Maps& m, const int32_t* root, int cy, int cx, int half, Obstacles& out) {
  out.y.clear(), out.x.clear();
  window_rows(m, root, cy - half, cy + half, cx - half, cx + half, [&](int64_t first, int y, int xs, int xe) {
    const uint8_t* row = m.field + first;
    uint8_t greatest = 0;
    for (int x = 0; x <= xe - xs; ++x) greatest = std::max(greatest, row[x]);
    if (greatest != kOccupiedField) return;
    for (int x = 0; x <= xe - xs; ++x)
      if (row[x] == kOccupiedField) out.y.push_back(static_cast<int16_t>(y - cy)), out.x.push_back(static_cast<int16_t>(xs + x - cx));
  });
}

int nearest_squared(const Obstacles& o, int16_t y, int16_t x) {
  int16_t nearest = std::numeric_limits<int16_t>::max();
  for (size_t i = 0; i < o.y.size(); ++i) {
    const int16_t dy = static_cast<int16_t>(o.y[i] - y), dx = static_cast<int16_t>(o.x[i] - x);
    const int16_t squared = static_cast<int16_t>(dy * dy + dx * dx);
    nearest = std::min(nearest, squared);
  }
  return nearest;
}

// Mends the field around a cell that is no longer occupied: only where that cell was the nearest obstacle.
void rebuild(const Maps& m, const int32_t* root, int cy, int cx, const uint8_t* cone, int reach, Obstacles& near) {
  find_occupied(m, root, cy, cx, 2 * reach, near);
  const int side = 2 * reach + 1;
  uint8_t by_square[2 * kTile * kTile] = {};
  for (int y = 0; y <= reach; ++y)
    for (int x = 0; x <= reach; ++x) by_square[y * y + x * x] = cone[(y + reach) * side + x + reach];
  window_rows(m, root, cy - reach, cy + reach, cx - reach, cx + reach, [&](int64_t first, int y, int xs, int xe) {
    const uint8_t* was = cone + (y - cy + reach) * side + xs - cx + reach;
    for (int x = 0; x <= xe - xs; ++x) {
      uint8_t& value = m.field[first + x];
      if (was[x] == 0 || (value != was[x] && (y != cy || xs + x != cx))) continue;
      const int squared = nearest_squared(near, static_cast<int16_t>(y - cy), static_cast<int16_t>(xs + x - cx));
      value = squared <= 2 * reach * reach ? by_square[squared] : 0;
    }
  });
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
    Obstacles near;
    for (int i = starts[g]; i < starts[g + 1]; ++i) {
      const Cell& c = cells[i];
      if (c.occupied)
        stamp(m, root, c.y, c.x, cone, reach);
      else  // no cell's nearest obstacle is found at it from now on
        m.field[static_cast<int64_t>(m.tile(root, c.y >> kTileBits, c.x >> kTileBits)) * kTileCells + Maps::inside(c.y, c.x)] = 0;
    }
    for (int i = starts[g]; i < starts[g + 1]; ++i)
      if (!cells[i].occupied) rebuild(m, root, cells[i].y, cells[i].x, cone, reach, near);
  });
}

}  // namespace gridslam
