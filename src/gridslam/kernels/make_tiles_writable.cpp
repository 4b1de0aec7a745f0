// Copy on write, the serial phase between finding the tiles that a step touches and writing to them. Stops when no free
// ids are left; the caller allocates more and continues.
#include <cstring>

#include "maps.hpp"

namespace gridslam {

void make_tiles_writable(const Maps& m, int32_t* page_refs, int32_t* tile_refs, const int32_t* free_pages,
                         int64_t n_free_pages, const int32_t* free_tiles, int64_t n_free_tiles,
                         const int32_t* tiles_to_write, int64_t n, int64_t used[3]) {
  int64_t pages_left = n_free_pages, tiles_left = n_free_tiles;
  int64_t i = 0;
  for (; i < n; ++i) {
    const int32_t row = tiles_to_write[3 * i], ty = tiles_to_write[3 * i + 1], tx = tiles_to_write[3 * i + 2];
    int32_t& page = m.root(row)[((ty >> kPageBits) - m.page_row0) * m.page_cols + (tx >> kPageBits) - m.page_col0];
    if (page == 0 || page_refs[page] > 1) {
      if (pages_left == 0) break;
      const int32_t fresh = free_pages[--pages_left];
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
        m.pages[static_cast<int64_t>(page) * kPageTiles + ((ty & kPageMask) << kPageBits) + (tx & kPageMask)];
    if (tile == 0 || tile_refs[tile] > 1) {
      if (tiles_left == 0) break;
      const int64_t fresh = free_tiles[--tiles_left];
      std::memcpy(m.log_odds + fresh * kTileCells, m.log_odds + static_cast<int64_t>(tile) * kTileCells,
                  kTileCells * sizeof(int16_t));
      std::memcpy(m.field + fresh * kTileCells, m.field + static_cast<int64_t>(tile) * kTileCells, kTileCells);
      if (tile != 0) --tile_refs[tile];
      tile_refs[fresh] = 1;
      tile = static_cast<int32_t>(fresh);
    }
  }
  used[0] = n_free_pages - pages_left;
  used[1] = n_free_tiles - tiles_left;
  used[2] = i;
}

}  // namespace gridslam
