// Many scans in one call.
#pragma once
#include "maps.hpp"

namespace gridslam {

// Scans with their poses; scan i has ends starts[i] to starts[i + 1] - 1.
struct Scans {
  const double* poses;    // (n, 3)
  const double* ends;     // (., 2)
  const int64_t* starts;  // (n + 1)
  const double* origins;  // (n, 2)
  int n;
  const double* pose(int i) const { return poses + 3 * static_cast<int64_t>(i); }
  const double* ends_of(int i) const { return ends + 2 * starts[i]; }
  int beams(int i) const { return static_cast<int>(starts[i + 1] - starts[i]); }
};

// How often pages and tiles are used, and those that nothing uses, the next to be taken last.
struct FreeTiles {
  int32_t *page_refs, *tile_refs;
  const int32_t* pages;
  int64_t n_pages;
  const int32_t* tiles;
  int64_t n_tiles;
};

// Which scans are weighed in between: scan i when after[i] >= 1 of them, ascending, are drawn.
struct Weighing {
  const int64_t* after;
  int n;
  double reach_cells, scale_m;
  float* weights;
};

struct Drawn {
  int64_t pages, tiles;  // taken
  int scans;
};

// Draws scans first to last - 1, those before being drawn, into map 0, up to one that may need more tiles than are free
// or than `room`.
Drawn draw_scans(const Maps& m, const FreeTiles& spare, const Scans& scans, int first, int last, double resolution,
                 const Evidence& e, const uint8_t* cone, int reach, int64_t room, const Weighing& weighing);

}  // namespace gridslam
