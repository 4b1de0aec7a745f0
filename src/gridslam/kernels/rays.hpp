// The rays of a scan as lines of cells, and the tiles that they cross.
#pragma once
#include "maps.hpp"

namespace gridslam {

// A bitmap over the tiles around one scan.
class TileSet {
 public:
  int y0 = 0, x0 = 0, rows = 0, cols = 0;
  void reset(int y_min, int y_max, int x_min, int x_max) {
    y0 = y_min, x0 = x_min, rows = y_max - y_min + 1, cols = x_max - x_min + 1;
    marks_.assign(static_cast<size_t>(rows) * cols, 0);
  }
  // A tile's place in the bitmap; of tiles beside it, `cols` or 1 before and after.
  ptrdiff_t index(int ty, int tx) const { return static_cast<ptrdiff_t>(ty - y0) * cols + (tx - x0); }
  void mark_at(ptrdiff_t index) { marks_[static_cast<size_t>(index)] = 1; }
  void mark(int ty, int tx) { mark_at(index(ty, tx)); }
  // Calls visit(tile y, tile x) for those that are marked, ascending.
  template <class Visit>
  void each(const Visit& visit) const {
    const uint8_t* mark = marks_.data();
    for (int y = y0; y < y0 + rows; ++y)
      for (int x = x0; x < x0 + cols; ++x)
        if (*mark++) visit(y, x);
  }
  int64_t count() const { return std::count(marks_.begin(), marks_.end(), 1); }

 private:
  std::vector<uint8_t> marks_;
};

// The cells of a scan as seen from one pose: where the laser is, and where the beams end.
struct Fan {
  int x = 0, y = 0;
  std::vector<int> xs, ys;
  std::vector<double> slopes;  // of the beams' lines, as Line has them

  void see(const Pose& pose, const double* ends, int b, const double* origin, double scale);
  Line line(size_t j) const { return Line(x, y, xs[j], ys[j], slopes[j]); }
  // The longest line, in cells.
  int reach() const {
    int most = 0;
    for (size_t j = 0; j < xs.size(); ++j) most = std::max({most, std::abs(xs[j] - x), std::abs(ys[j] - y)});
    return most;
  }
  // The tiles that the lines cross where they free cells, and those of their ends.
  void tiles(TileSet& set) const;
};

// Makes tiles the own ones of their map: copies those that another uses, too. False where no free id is left.
struct Arena {
  int32_t *page_refs, *tile_refs;
  const int32_t *free_pages, *free_tiles;  // taken from the end
  int64_t n_free_pages, n_free_tiles;      // that are left
  bool own(const Maps& m, int row, int tile_y, int tile_x);
};

// The tiles within reach of n changed cells of one map, at least one; a window of at most a tile's side lies in the
// tiles of its four corners.
void tiles_near_cells(const Cell* cells, int n, int reach, TileSet& set);

}  // namespace gridslam
