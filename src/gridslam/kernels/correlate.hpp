// Searching a whole window of a map for a scan: the pyramid of maxima, and branch and bound over it.
#pragma once
#include "maps.hpp"

namespace gridslam {

constexpr int kStrip = 64;  // nodes of a row that are bounded at once, and the zeros before each row of `top`

// For each level h the greatest value of the square of 2^h cells that begins at a cell. Levels below the top lie as the
// map does, in a frame of `side` zeros; the top is split by the cells' remainders modulo its side, so that neighbouring
// nodes are neighbouring bytes.
template <class Byte>
struct Pyramid {
  Byte* fine;  // (levels, rows, cols): cell (y, x) of the map at [y + side, x + side]
  int levels, rows, cols;
  Byte* top;  // (side, side, top_rows + 1, kStrip + top_cols): zeros before each row and in the last

  int side() const { return 1 << levels; }
  int top_rows() const { return (rows + side() - 1) >> levels; }
  int top_cols() const { return (cols + side() - 1) >> levels; }
  int stride() const { return kStrip + top_cols(); }
  Byte* level(int h) const { return fine + static_cast<int64_t>(h) * rows * cols; }
  Byte* phase(int y, int x) const {  // of the node that begins at frame cell (y, x); its first row's first node
    const int mask = side() - 1;
    return top + static_cast<int64_t>(((y & mask) << levels) + (x & mask)) * (top_rows() + 1) * stride() + kStrip;
  }
};

void max_pyramid(const uint8_t* likelihood, int rows, int cols, const Pyramid<uint8_t>& out);

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
