// The tiles that the rays of a scan cross.
#pragma once
#include "maps.hpp"

namespace gridslam {

// A bitmap over the tiles around one scan.
class TileSet {
 public:
  const int y0, x0, rows, cols;
  TileSet(int y_min, int y_max, int x_min, int x_max)
      : y0(y_min),
        x0(x_min),
        rows(y_max - y_min + 1),
        cols(x_max - x_min + 1),
        marks_(static_cast<size_t>(rows) * cols, 0) {}
  void mark(int ty, int tx) { marks_[static_cast<size_t>(ty - y0) * cols + (tx - x0)] = 1; }
  // Calls visit(tile y, tile x) for those that are marked, ascending.
  template <class Visit>
  void each(const Visit& visit) const {
    const uint8_t* mark = marks_.data();
    for (int y = y0; y < y0 + rows; ++y)
      for (int x = x0; x < x0 + cols; ++x)
        if (*mark++) visit(y, x);
  }

 private:
  std::vector<uint8_t> marks_;
};

// The cells of a scan as seen from one pose: where the laser is, and where the beams end.
struct Fan {
  int x, y;
  std::vector<int> xs, ys;
  Fan(const Pose& pose, const double* ends, int b, const double* origin, double scale)
      : x(cell_of(pose.world_x(origin), scale)), y(cell_of(pose.world_y(origin), scale)), xs(b), ys(b) {
    cells_of(pose, ends, b, scale, xs.data(), ys.data());
  }
  Line line(size_t j) const { return Line(x, y, xs[j], ys[j]); }

  // The tiles that the lines cross where they free cells, and those of their ends.
  TileSet tiles() const {
    int x_min = x, x_max = x, y_min = y, y_max = y;
    for (size_t j = 0; j < xs.size(); ++j) {
      x_min = std::min(x_min, xs[j]), x_max = std::max(x_max, xs[j]);
      y_min = std::min(y_min, ys[j]), y_max = std::max(y_max, ys[j]);
    }
    TileSet set(y_min >> kTileBits, y_max >> kTileBits, x_min >> kTileBits, x_max >> kTileBits);
    for (size_t j = 0; j < xs.size(); ++j) mark(line(j), set);
    return set;
  }

 private:
  static void cells_of(const Pose& pose, const double* ends, int b, double scale, int* xs, int* ys);
  static void mark(const Line& line, TileSet& set) {
    const int most = line.n <= kFreeCells ? line.n : kFreeCells - 1;
    if (most < line.n) {
      const int end = line.major(line.n) >> kTileBits, aside = line.minor(line.n) >> kTileBits;
      line.along_x ? set.mark(aside, end) : set.mark(end, aside);
    }
    for (int i = 0; i <= most;) {
      const int major = line.major(i), inside = major & kTileMask, tile = major >> kTileBits;
      const int last = std::min(most, i + (line.major_step > 0 ? kTileMask - inside : inside));
      for (const int end :
           {i, last}) {  // the minor axis is monotone, and within a tile's width it crosses one border at most
        const int aside = line.minor(end) >> kTileBits;
        line.along_x ? set.mark(aside, tile) : set.mark(tile, aside);
      }
      i = last + 1;
    }
  }
};

}  // namespace gridslam
