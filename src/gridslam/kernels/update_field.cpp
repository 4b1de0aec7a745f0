// The distance field that follows the cells that changed.
#include "row_bits.hpp"
#include "update.hpp"

namespace gridslam {
namespace {

// Calls visit(offset of a tile's row, y, x of its first cell) for the tiles' rows that a window crosses; the empty tile
// is left out.
template <class Visit>
GRIDSLAM_INLINE void window_rows(const Maps& m, const int32_t* root, int y0, int y1, int x0, int x1,
                                 const Visit& visit) {
  for (int x = x0 & ~kTileMask; x <= x1; x += kTile)
    for (int ys = y0; ys <= y1; ys = (ys | kTileMask) + 1) {
      const int64_t tile = m.tile(root, ys >> kTileBits, x >> kTileBits);
      if (tile == 0) continue;
      for (int y = ys; y <= std::min(y1, ys | kTileMask); ++y) visit(tile * kTileCells + Maps::inside(y, 0), y, x);
    }
}

// A newly occupied cell's cone, as a maximum over what is there.
GRIDSLAM_VERSIONS void raise_cone(const Maps& m, const int32_t* root, int cy, int cx, const Cone& cone) {
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

void follow(const Maps& m, const int32_t* root, const Cell* cells, int n, const Cone& cone) {
  for (int i = 0; i < n; ++i) {
    const Cell& c = cells[i];
    if (c.occupied)
      raise_cone(m, root, c.y, c.x, cone);
    else  // no cell's nearest obstacle is found at it from now on
      m.field[m.address(root, c.y, c.x)] = 0;
  }
  for (int i = 0; i < n; ++i)
    if (!cells[i].occupied) rebuild_field(m, root, cells[i].y, cells[i].x, cone);
}

}  // namespace gridslam
