// The binary Bayes filter along the rays of a scan, and the distance field that follows the cells that changed.

#include <bit>
#include <cstring>

#include "rays.hpp"

#if defined(GRIDSLAM_SSE2)
#include <emmintrin.h>
#endif

namespace gridslam {
namespace {

inline int value_or_zero(int16_t v) { return v == kUnknown ? 0 : v; }

// Frees the passed cells of a tile; returns a bit for each two rows in which some stop being occupied. All in 16 bits
// and without a branch inside a row, for many cells at once.
template <class Count>
inline uint16_t free_tile(int16_t* cells, const Count* passes, int stride, const Evidence& e) {
  const int16_t least = static_cast<int16_t>(e.min), occupied = static_cast<int16_t>(e.occupied_above),
                miss = static_cast<int16_t>(-e.miss);
  constexpr int kGreatest = std::min<int64_t>(std::numeric_limits<Count>::max(), std::numeric_limits<int>::max());
  const Count most = static_cast<Count>(std::min((e.max - e.min) / miss + 1, kGreatest));  // passes that free any cell
  int16_t left[kTile] = {};
  for (int y = 0; y < kTile; ++y, cells += kTile, passes += stride) {
    uint64_t words[kTile * sizeof(Count) / sizeof(uint64_t)], any = 0;
    std::memcpy(words, passes, sizeof(words));
    for (uint64_t w : words) any |= w;
    if (any == 0) continue;
    const int16_t pair = static_cast<int16_t>(1 << (y >> 1));
    for (int i = 0; i < kTile; ++i) {
      const int16_t count = static_cast<int16_t>(std::min(passes[i], most));
      const int16_t before = cells[i] == kUnknown ? int16_t{0} : cells[i];
      const int16_t above = static_cast<int16_t>(before - least), loss = static_cast<int16_t>(count * miss);
      const int16_t after =
          static_cast<int16_t>((above > loss ? static_cast<int16_t>(above - loss) : int16_t{0}) + least);
      left[i] = static_cast<int16_t>(left[i] | (-((before > occupied) & (after <= occupied)) & pair));
      cells[i] = count ? after : cells[i];
    }
  }
  int16_t some = 0;
  for (int i = 0; i < kTile; ++i) some = static_cast<int16_t>(some | left[i]);
  return static_cast<uint16_t>(some);
}

GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint8_t* passes, int stride, const Evidence& e) {
  return free_tile<uint8_t>(cells, passes, stride, e);
}
GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint16_t* passes, int stride, const Evidence& e) {
  return free_tile<uint16_t>(cells, passes, stride, e);
}
GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint32_t* passes, int stride, const Evidence& e) {
  return free_tile<uint32_t>(cells, passes, stride, e);
}

// A bit for each of the 32 cells of a tile's row that equals `wanted` and is not 0.
inline uint32_t equal_bytes(const uint8_t* cells, const uint8_t* wanted) {
  uint32_t bits = 0;
#if defined(GRIDSLAM_SSE2)
  for (int i = 0; i < kTile; i += 16) {
    const __m128i a = _mm_loadu_si128(reinterpret_cast<const __m128i*>(cells + i)),
                  b = _mm_loadu_si128(reinterpret_cast<const __m128i*>(wanted + i));
    const __m128i found = _mm_andnot_si128(_mm_cmpeq_epi8(b, _mm_setzero_si128()), _mm_cmpeq_epi8(a, b));
    bits |= static_cast<uint32_t>(_mm_movemask_epi8(found)) << i;
  }
#else
  for (int i = 0; i < kTile; ++i) bits |= static_cast<uint32_t>(cells[i] == wanted[i] && wanted[i] != 0) << i;
#endif
  return bits;
}

// A bit for each occupied cell of a tile's row, read off the field.
inline uint32_t occupied_bits(const uint8_t* cells) {
  static constexpr std::array<uint8_t, kTile> kOccupied = [] {
    std::array<uint8_t, kTile> row{};
    row.fill(kOccupiedField);
    return row;
  }();
  return equal_bytes(cells, kOccupied.data());
}

// How often the rays of one scan pass each cell: a rectangle of counters about the laser, of which only the tiles that
// they cross are used. Tiles beyond hold ends alone.
template <class Count>
class PassCounts {
 public:
  PassCounts(const TileSet& tiles, int y, int x, std::vector<Count>& memory)
      : y0_(std::max(tiles.y0, tile_of(y - kFreeCells)) * kTile),
        x0_(std::max(tiles.x0, tile_of(x - kFreeCells)) * kTile),
        height_((std::min(tiles.y0 + tiles.rows - 1, tile_of(y + kFreeCells)) + 1) * kTile - y0_),
        width_((std::min(tiles.x0 + tiles.cols - 1, tile_of(x + kFreeCells)) + 1) * kTile - x0_),
        tiles_(tiles) {
    const size_t size = static_cast<size_t>(height_) * width_;
    if (memory.size() < size) memory.resize(size);
    counts_ = memory.data();
    tiles.each([&](int ty, int tx) {
      if (!covers(ty * kTile, tx * kTile)) return;
      Count* first = at(ty * kTile, tx * kTile);
      for (int y = 0; y < kTile; ++y) std::fill_n(first + static_cast<size_t>(y) * width_, kTile, Count{0});
    });
  }
  Count* at(int y, int x) { return counts_ + static_cast<size_t>(y - y0_) * width_ + (x - x0_); }
  bool covers(int y, int x) const {
    return static_cast<unsigned>(y - y0_) < static_cast<unsigned>(height_) &&
           static_cast<unsigned>(x - x0_) < static_cast<unsigned>(width_);
  }

  // Counts the cells that a line frees.
  void add(const Line& line) {
    const int64_t row = width_, major = line.major_step * (line.along_x ? 1 : row),
                  minor = line.minor_step * (line.along_x ? row : 1);
    const uint64_t slope = line.slope;
    const int n = line.freed();
    uint64_t aside = line.start;
    Count* cell = at(line.y0, line.x0);
    for (int i = 0; i < n; ++i, cell += major, aside += slope) ++cell[static_cast<int64_t>(aside >> 32) * minor];
  }

  // Frees the cells that were passed; those that stop being occupied, while their field is still that of occupied
  // cells, go to `changed`.
  void apply(const Maps& m, const int32_t* root, const Evidence& e, int row, std::vector<Cell>& changed) {
    int64_t tile = 0;
    int y = 0, x = 0;
    const auto pass = [&] {
      if (tile == 0) return;
      for (unsigned pairs = free_tile(m.log_odds + tile, at(y, x), width_, e); pairs != 0; pairs &= pairs - 1)
        for (int down = 2 * std::countr_zero(pairs), last = down + 1; down <= last; ++down) {
          const int64_t first = tile + down * kTile;
          for (uint32_t left = occupied_bits(m.field + first); left != 0; left &= left - 1) {
            const int across = std::countr_zero(left);
            if (m.log_odds[first + across] <= e.occupied_above) changed.push_back({row, y + down, x + across, 0});
          }
        }
    };
    tiles_.each([&](int ty, int tx) {  // a tile comes from memory while the one before it is freed
      if (!covers(ty * kTile, tx * kTile)) return;
      const int64_t next = m.tile(root, ty, tx) * static_cast<int64_t>(kTileCells);
      for (int i = 0; i < kTileCells; i += 64 / sizeof(int16_t)) prefetch(m.log_odds + next + i);
      pass();
      tile = next, y = ty * kTile, x = tx * kTile;
    });
    pass();
  }

 private:
  static int tile_of(int cell) { return cell >> kTileBits; }

  int y0_, x0_, height_, width_;
  const TileSet& tiles_;
  Count* counts_;
};

template <class Count>
void update_one(const Maps& m, int row, const Pose& pose, const double* ends, int b, const double* origin, double scale,
                const Evidence& e, std::vector<Cell>& changed) {
  thread_local std::vector<Count> memory;
  const int32_t* root = m.root(row);
  const Fan fan(pose, ends, b, origin, scale);
  const TileSet tiles = fan.tiles();
  PassCounts<Count> passes(tiles, fan.y, fan.x, memory);
  for (int j = 0; j < b; ++j) passes.add(fan.line(j));
  for (int j = 0; j < b; ++j)
    if (passes.covers(fan.ys[j], fan.xs[j])) *passes.at(fan.ys[j], fan.xs[j]) = 0;  // no end of the scan is freed by it
  passes.apply(m, root, e, row, changed);
  for (int j = 0; j < b; ++j) {
    const int y = fan.ys[j], x = fan.xs[j];
    int16_t& cell = m.log_odds[static_cast<int64_t>(m.tile(root, y >> kTileBits, x >> kTileBits)) * kTileCells +
                               Maps::inside(y, x)];
    const int before = value_or_zero(cell), after = std::min(before + e.hit, e.max);
    cell = static_cast<int16_t>(after);
    if (before <= e.occupied_above && after > e.occupied_above) changed.push_back({row, y, x, 1});
  }
}

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

// Calls visit(offset of a tile's row, y, x of its first cell) for the tiles' rows that a window crosses; the empty tile
// is left out.
template <class Visit>
void window_rows(const Maps& m, const int32_t* root, int y0, int y1, int x0, int x1, const Visit& visit) {
  for (int x = x0 & ~kTileMask; x <= x1; x += kTile)
    for (int ys = y0; ys <= y1; ys = (ys | kTileMask) + 1) {
      const int64_t tile = m.tile(root, ys >> kTileBits, x >> kTileBits);
      if (tile == 0) continue;
      for (int y = ys; y <= std::min(y1, ys | kTileMask); ++y) visit(tile * kTileCells + Maps::inside(y, 0), y, x);
    }
}

// A newly occupied cell's cone, as a maximum over what is there.
void raise_cone(const Maps& m, const int32_t* root, int cy, int cx, const Cone& cone) {
  const int r = cone.reach;
  window_rows(m, root, cy - r, cy + r, cx - r, cx + r, [&](int64_t first, int y, int x) {
    uint8_t* to = m.field + first;
    const uint8_t* from = cone.over(y - cy, x - cx);
    for (int i = 0; i < kTile; ++i) to[i] = std::max(to[i], from[i]);
  });
}

struct Row {
  int square;  // of its distance
  uint64_t bits;
};

// The occupied cells within 2 * reach of a cell, a bit for each: at most 61 a side.
struct Obstacles {
  std::array<uint64_t, 2 * kTile> rows;
  int half;

  Obstacles(const Maps& m, const int32_t* root, int cy, int cx, int reach) : half(2 * reach) {
    std::fill_n(rows.begin(), 2 * half + 1, uint64_t{0});
    window_rows(m, root, cy - half, cy + half, cx - half, cx + half, [&](int64_t first, int y, int x) {
      const uint64_t bits = occupied_bits(m.field + first);
      const int shift = x - (cx - half);
      rows[y - cy + half] |= shift >= 0 ? bits << shift : bits >> -shift;
    });
  }

  // Those of the rows within reach of row y that hold some, nearest first; rows on both sides together.
  int about(int y, Row* found) const {
    int n = 0;
    for (int d = 0; d <= half / 2; ++d)
      if (const uint64_t bits = rows[y + half - d] | rows[y + half + d]) found[n++] = {d * d, bits};
    return n;
  }
};

// Recomputes cells of a tile's row, which have bits `left`: column is that of the row's first cell among those of
// `rows`.
GRIDSLAM_VERSIONS void mend(uint8_t* cells, uint32_t left, int column, const Row* rows, int n, const Cone& cone) {
  for (; left != 0; left &= left - 1) {
    const int i = std::countr_zero(left), at = column + i;
    int nearest = std::numeric_limits<int>::max();
    for (int k = 0; k < n && rows[k].square < nearest; ++k) {
      const int aside = std::min(std::countr_zero(rows[k].bits >> at),
                                 std::countl_zero(rows[k].bits << (63 - at)));  // 64 where there is none
      nearest = std::min(nearest, rows[k].square + aside * aside);
    }
    cells[i] = cone.at(nearest);
  }
}

// Recomputes the field around a freed cell, where that cell was the nearest obstacle.
void rebuild_field(const Maps& m, const int32_t* root, int cy, int cx, const Cone& cone) {
  const int r = cone.reach;
  const Obstacles near(m, root, cy, cx, r);
  window_rows(m, root, cy - r, cy + r, cx - r, cx + r, [&](int64_t first, int y, int x) {
    uint32_t left = equal_bytes(m.field + first, cone.over(y - cy, x - cx));
    if (y == cy && x == (cx & ~kTileMask)) left |= 1u << (cx - x);
    if (left == 0) return;
    Row about[kTile];
    const int n = near.about(y - cy, about);
    mend(m.field + first, left, x - cx + near.half, about, n, cone);
  });
}

}  // namespace

void update_log_odds(const Maps& m, const int32_t* rows, const double* poses, int k, const double* ends, int b,
                     const double* origin, double resolution, const Evidence& e, int threads,
                     std::vector<Cell>& changed) {
  std::vector<std::vector<Cell>> found(k);
  parallel_for(k, threads, [&](int i) {
    const auto update = b <= std::numeric_limits<uint8_t>::max()    ? update_one<uint8_t>
                        : b <= std::numeric_limits<uint16_t>::max() ? update_one<uint16_t>
                                                                    : update_one<uint32_t>;
    update(m, rows[i], Pose(poses + 3 * i), ends, b, origin, 1.0 / resolution, e, found[i]);
  });
  for (const auto& part : found) changed.insert(changed.end(), part.begin(), part.end());
}

void update_field(const Maps& m, const Cell* cells, int n, const uint8_t* cone_cells, int reach, int threads) {
  const Cone cone(cone_cells, reach);
  std::vector<int> starts;  // cells come grouped by row
  for (int i = 0; i < n; ++i)
    if (i == 0 || cells[i].row != cells[i - 1].row) starts.push_back(i);
  starts.push_back(n);
  parallel_for(static_cast<int>(starts.size()) - 1, threads, [&](int g) {
    const int32_t* root = m.root(cells[starts[g]].row);
    for (int i = starts[g]; i < starts[g + 1]; ++i) {
      const Cell& c = cells[i];
      if (c.occupied)
        raise_cone(m, root, c.y, c.x, cone);
      else  // no cell's nearest obstacle is found at it from now on
        m.field[static_cast<int64_t>(m.tile(root, c.y >> kTileBits, c.x >> kTileBits)) * kTileCells +
                Maps::inside(c.y, c.x)] = 0;
    }
    for (int i = starts[g]; i < starts[g + 1]; ++i)
      if (!cells[i].occupied) rebuild_field(m, root, cells[i].y, cells[i].x, cone);
  });
}

}  // namespace gridslam
