// Copy on write: what a step writes to belongs to its map alone, first.
#include <cstring>

#include "rays.hpp"

namespace gridslam {

bool Arena::own(const Maps& m, int row, int tile_y, int tile_x) {
  int32_t& page =
      m.root(row)[((tile_y >> kPageBits) - m.page_row0) * m.page_cols + (tile_x >> kPageBits) - m.page_col0];
  if (page == 0 || page_refs[page] > 1) {
    if (n_free_pages == 0) return false;
    const int32_t fresh = free_pages[--n_free_pages];
    int32_t* to = m.pages + static_cast<int64_t>(fresh) * kPageTiles;
    std::memcpy(to, m.pages + static_cast<int64_t>(page) * kPageTiles, kPageTiles * sizeof(int32_t));
    if (page != 0) {
      --page_refs[page];
      for (int t = 0; t < kPageTiles; ++t)
        if (to[t] != 0) ++tile_refs[to[t]];
    }
    page_refs[fresh] = 1;
    page = fresh;
  }
  int32_t& tile =
      m.pages[static_cast<int64_t>(page) * kPageTiles + ((tile_y & kPageMask) << kPageBits) + (tile_x & kPageMask)];
  if (tile == 0 || tile_refs[tile] > 1) {
    if (n_free_tiles == 0) return false;
    const int64_t fresh = free_tiles[--n_free_tiles];
    m.log_odds.copy_tile(tile, fresh);
    std::memcpy(m.field + fresh * kTileCells, m.field + static_cast<int64_t>(tile) * kTileCells, kTileCells);
    if (tile != 0) --tile_refs[tile];
    tile_refs[fresh] = 1;
    tile = static_cast<int32_t>(fresh);
  }
  return true;
}

int64_t make_tiles_writable(const Maps& m, Arena& arena, const int32_t* tiles_to_write, int64_t n) {
  for (int64_t i = 0; i < n; ++i)
    if (!arena.own(m, tiles_to_write[3 * i], tiles_to_write[3 * i + 1], tiles_to_write[3 * i + 2])) return i;
  return n;
}

}  // namespace gridslam
