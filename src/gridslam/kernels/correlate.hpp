// Searching a whole window of a map for a scan: maxima of its squares, and branch and bound over them.
#pragma once
#include "maps.hpp"

namespace gridslam {

constexpr int kNode = 8;    // cells a side of a node
constexpr int kTop = 16;    // and of the largest one, four nodes
constexpr int kStrip = 32;  // largest nodes of a row that are bounded at once, and the zeros before each row of `top`

// A map's likelihoods in a frame of kTop zeros, and the greatest of each square of cells, by the cell at which it
// begins. Those of the largest squares are split by the cells' remainders modulo kTop, so that neighbouring nodes are
// neighbouring bytes.
template <class Byte>
struct Pyramid {
  Byte *cells, *nodes;  // (rows, cols): cell (y, x) of the map at [y + kTop, x + kTop]
  int rows, cols;
  Byte* top;  // (kTop, kTop, top_rows + 1, kStrip + top_cols): zeros before each row and in the last

  int top_rows() const { return (rows + kTop - 1) / kTop; }
  int top_cols() const { return (cols + kTop - 1) / kTop; }
  int stride() const { return kStrip + top_cols(); }
  int64_t index(int y, int x) const { return static_cast<int64_t>(y) * cols + x; }
  int64_t phase_size() const { return static_cast<int64_t>(top_rows() + 1) * stride(); }
  Byte* phase(int y, int x) const {  // of the square that begins at frame cell (y, x); its first row's first
    return top + ((y & (kTop - 1)) * kTop + (x & (kTop - 1))) * phase_size() + kStrip;
  }
};

// The likelihoods are those of the distances in tiles `ids` (tile_rows, tile_cols) of `field`, by a table of 256.
void max_pyramid(const uint8_t* field, const int32_t* ids, int tile_rows, int tile_cols, const uint8_t* likelihood,
                 const Pyramid<uint8_t>& out);

// Lattice poses: the scan's origin at the centre of a cell [x0, x1) x [y0, y1) of the map, and one of the headings.
struct Lattice {
  int x0, x1, y0, y1;
  const double* headings;
  int turns;
};

// Poses d = (x, y, heading) - centre, in cells and rad, with d^T information d <= distance^2.
struct Gate {
  const double *centre, *information;
  double distance;
};

struct SearchLimits {
  int count, min_sum;  // how many poses, and the least sum of any
  // Each after the first: least part of the first's sum, and how far from all before.
  double min_runner_up_ratio, min_distance_cells, min_distance_rad;
};

struct ScoredPose {
  int32_t sum, heading, y, x;
};

void correlate(const Pyramid<const uint8_t>& p, const double* ends, int b, const Lattice& lattice, const Gate& gate,
               const SearchLimits& limits, std::vector<ScoredPose>& found);

}  // namespace gridslam
