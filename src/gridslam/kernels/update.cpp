// The binary Bayes filter along the rays of a scan, and the distance field that follows the cells that changed.

#include <bit>
#include <cstring>

#include "maps.hpp"

namespace gridslam {
namespace {

inline int value_or_zero(int16_t v) { return v == kUnknown ? 0 : v; }

// Frees the passed cells of a tile; says whether some of them stop being occupied. All in 16 bits and without a branch inside
// a row, for many cells at once.
template <class Count>
inline bool free_tile(int16_t* cells, const Count* passes, int stride, const Evidence& e) {
  const int16_t least = static_cast<int16_t>(e.min), occupied = static_cast<int16_t>(e.occupied_above), miss = static_cast<int16_t>(-e.miss);
  const int16_t enough = static_cast<int16_t>((e.max - e.min) / miss + 1);  // passes that free any cell
  int16_t left[kTile] = {};
  for (int y = 0; y < kTile; ++y, cells += kTile, passes += stride) {
    uint64_t words[kTile * sizeof(Count) / sizeof(uint64_t)], any = 0;
    std::memcpy(words, passes, sizeof(words));
    for (uint64_t w : words) any |= w;
    if (any == 0) continue;
    for (int i = 0; i < kTile; ++i) {
      const int16_t count = std::min(static_cast<int16_t>(passes[i]), enough);
      const int16_t before = cells[i] == kUnknown ? int16_t{0} : cells[i];
      const int16_t above = static_cast<int16_t>(before - least), loss = static_cast<int16_t>(count * miss);
      const int16_t after = static_cast<int16_t>((above > loss ? static_cast<int16_t>(above - loss) : int16_t{0}) + least);
      left[i] = static_cast<int16_t>(left[i] | ((before > occupied) & (after <= occupied)));
      cells[i] = count ? after : cells[i];
    }
  }
  int16_t some = 0;
  for (int i = 0; i < kTile; ++i) some = static_cast<int16_t>(some | left[i]);
  return some != 0;
}

GRIDSLAM_VERSIONS bool free_tile(int16_t* cells, const uint8_t* passes, int stride, const Evidence& e) { return free_tile<uint8_t>(cells, passes, stride, e); }
GRIDSLAM_VERSIONS bool free_tile(int16_t* cells, const uint16_t* passes, int stride, const Evidence& e) { return free_tile<uint16_t>(cells, passes, stride, e); }

// High bit of each byte that is 255, eight cells at once.
inline uint64_t occupied_bytes(const uint8_t* cells) {
  constexpr uint64_t kLow = 0x7f7f7f7f7f7f7f7fu;
  uint64_t word;
  std::memcpy(&word, cells, sizeof(word));
  const uint64_t zero_where_occupied = ~word;
  return ~(((zero_where_occupied & kLow) + kLow) | zero_where_occupied | kLow);
}

// How often the rays of one scan pass each cell of the tiles around it: a rectangle of counters, cut at tiles.
template <class Count>
class Passes {
 public:
  Passes(int y_min, int y_max, int x_min, int x_max, std::vector<Count>& memory)
      : y0_(y_min & ~kTileMask), x0_(x_min & ~kTileMask), height_((y_max | kTileMask) + 1 - y0_), width_((x_max | kTileMask) + 1 - x0_), counts_(memory) {
    counts_.assign(static_cast<size_t>(height_) * width_, 0);
  }
  Count* at(int y, int x) { return counts_.data() + static_cast<size_t>(y - y0_) * width_ + (x - x0_); }

  // Counts the cells of a line but its last.
  void add(const Line& line) {
    const int64_t row = width_, major = line.major_step * (line.along_x ? 1 : row), minor = line.minor_step * (line.along_x ? row : 1);
    const uint64_t slope = line.slope;
    const int n = line.n;
    uint64_t aside = line.start;
    Count* cell = at(line.y0, line.x0);
    for (int i = 0; i < n; ++i, cell += major, aside += slope) ++cell[static_cast<int64_t>(aside >> 32) * minor];
  }

  // Frees the cells that were passed; those that stop being occupied, as their field still says they are, go to `changed`.
  void apply(const Maps& m, const int32_t* root, const Evidence& e, int row, std::vector<Cell>& changed) {
    for (int y = y0_; y < y0_ + height_; y += kTile)
      for (int x = x0_; x < x0_ + width_; x += kTile) {
        const int64_t tile = m.tile(root, y >> kTileBits, x >> kTileBits) * static_cast<int64_t>(kTileCells);
        if (tile == 0 || !free_tile(m.log_odds + tile, at(y, x), width_, e)) continue;
        for (int word = 0; word < kTileCells; word += 8)
          for (uint64_t left = occupied_bytes(m.field + tile + word); left != 0; left &= left - 1) {
            const int i = word + (std::countr_zero(left) >> 3);
            if (m.log_odds[tile + i] <= e.occupied_above) changed.push_back({row, y + (i >> kTileBits), x + (i & kTileMask), 0});
          }
      }
  }

 private:
  int y0_, x0_, height_, width_;
  std::vector<Count>& counts_;
};

struct End {
  int y, x;
};

template <class Count>
void update_one(const Maps& m, int row, const Pose& pose, const double* ends, int b, const double* origin, double scale, const Evidence& e,
                std::vector<Cell>& changed) {
  thread_local std::vector<Count> memory;
  const int32_t* root = m.root(row);
  const int ox = cell_of(pose.world_x(origin), scale), oy = cell_of(pose.world_y(origin), scale);
  std::vector<End> hits(b);
  int x_min = ox, x_max = ox, y_min = oy, y_max = oy;
  for (int j = 0; j < b; ++j) {
    hits[j] = {cell_of(pose.world_y(ends + 2 * j), scale), cell_of(pose.world_x(ends + 2 * j), scale)};
    x_min = std::min(x_min, hits[j].x), x_max = std::max(x_max, hits[j].x);
    y_min = std::min(y_min, hits[j].y), y_max = std::max(y_max, hits[j].y);
  }
  Passes<Count> passes(y_min, y_max, x_min, x_max, memory);
  for (const End& h : hits) passes.add(Line(ox, oy, h.x, h.y));
  for (const End& h : hits) *passes.at(h.y, h.x) = 0;  // an end cell of this scan is not freed by it
  passes.apply(m, root, e, row, changed);
  for (const End& h : hits) {
    int16_t& cell = m.log_odds[static_cast<int64_t>(m.tile(root, h.y >> kTileBits, h.x >> kTileBits)) * kTileCells + Maps::inside(h.y, h.x)];
    const int before = value_or_zero(cell), after = std::min(before + e.hit, e.max);
    cell = static_cast<int16_t>(after);
    if (before <= e.occupied_above && after > e.occupied_above) changed.push_back({row, h.y, h.x, 1});
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
  static_assert(std::endian::native == std::endian::little, "the order of bytes in a word is that of the cells");
  out.y.clear(), out.x.clear();
  window_rows(m, root, cy - half, cy + half, cx - half, cx + half, [&](int64_t first, int y, int xs, int xe) {
    const int skipped = xs & kTileMask;
    const uint8_t* row = m.field + first - skipped;
    for (int word = skipped & ~7; word <= skipped + xe - xs; word += 8)
      for (uint64_t left = occupied_bytes(row + word); left != 0; left &= left - 1) {
        const int x = xs - skipped + word + (std::countr_zero(left) >> 3);
        if (x >= xs && x <= xe) out.y.push_back(static_cast<int16_t>(y - cy)), out.x.push_back(static_cast<int16_t>(x - cx));
      }
  });
}

GRIDSLAM_VERSIONS int nearest_squared(const Obstacles& o, int16_t y, int16_t x) {
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
  parallel_for(k, threads, [&](int i) {
    const auto update = b <= std::numeric_limits<uint8_t>::max() ? update_one<uint8_t> : update_one<uint16_t>;
    update(m, rows[i], Pose(poses + 3 * i), ends, b, origin, 1.0 / resolution, e, found[i]);
  });
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
