// Which tiles a step will write to: found in parallel, nothing is written here.

#include "maps.hpp"

namespace gridslam {
namespace {

// A bitmap over the tiles around one scan.
class TileSet {
 public:
  TileSet(int y_min, int y_max, int x_min, int x_max)
      : y0_(y_min), x0_(x_min), cols_(x_max - x_min + 1), marks_(static_cast<size_t>(y_max - y_min + 1) * cols_, 0) {}
  void mark(int ty, int tx) { marks_[static_cast<size_t>(ty - y0_) * cols_ + (tx - x0_)] = 1; }
  void emit(int row, Touched& out) const {
    for (size_t i = 0; i < marks_.size(); ++i)
      if (marks_[i]) out.push_back({row, y0_ + static_cast<int>(i / cols_), x0_ + static_cast<int>(i % cols_)});
  }

 private:
  int y0_, x0_;
  size_t cols_;
  std::vector<uint8_t> marks_;
};

void mark_line(const Line& line, TileSet& set) {
  for (int i = 0; i <= line.n;) {
    const int major = line.major(i), inside = major & kTileMask, tile = major >> kTileBits;
    const int last = std::min(line.n, i + (line.major_step > 0 ? kTileMask - inside : inside));
    for (const int end : {i, last}) {  // the minor axis is monotone, and within a tile's width it crosses one border at most
      const int aside = line.minor(end) >> kTileBits;
      line.along_x ? set.mark(aside, tile) : set.mark(tile, aside);
    }
    i = last + 1;
  }
}

}  // namespace

void touch_rays(const int32_t* rows, const double* poses, int k, const double* ends, int b, const double* origin,
                double resolution, int threads, Touched& out) {
  std::vector<Touched> found(k);
  const double scale = 1.0 / resolution;
  parallel_for(k, threads, [&](int i) {
    const Pose pose(poses + 3 * i);
    const int ox = cell_of(pose.world_x(origin), scale), oy = cell_of(pose.world_y(origin), scale);
    std::vector<int> xs(b), ys(b);
    int x_min = ox, x_max = ox, y_min = oy, y_max = oy;
    for (int j = 0; j < b; ++j) {
      xs[j] = cell_of(pose.world_x(ends + 2 * j), scale);
      ys[j] = cell_of(pose.world_y(ends + 2 * j), scale);
      x_min = std::min(x_min, xs[j]), x_max = std::max(x_max, xs[j]);
      y_min = std::min(y_min, ys[j]), y_max = std::max(y_max, ys[j]);
    }
    TileSet set(y_min >> kTileBits, y_max >> kTileBits, x_min >> kTileBits, x_max >> kTileBits);
    for (int j = 0; j < b; ++j) mark_line(Line(ox, oy, xs[j], ys[j]), set);
    set.emit(rows[i], found[i]);
  });
  for (const auto& part : found) out.insert(out.end(), part.begin(), part.end());
}

void touch_cells(const Cell* cells, int n, int reach, Touched& out) {
  for (int first = 0, last; first < n; first = last) {  // cells come grouped by row
    int y_min = cells[first].y, y_max = y_min, x_min = cells[first].x, x_max = x_min;
    for (last = first; last < n && cells[last].row == cells[first].row; ++last) {
      y_min = std::min(y_min, cells[last].y), y_max = std::max(y_max, cells[last].y);
      x_min = std::min(x_min, cells[last].x), x_max = std::max(x_max, cells[last].x);
    }
    TileSet set((y_min - reach) >> kTileBits, (y_max + reach) >> kTileBits, (x_min - reach) >> kTileBits, (x_max + reach) >> kTileBits);
    for (int i = first; i < last; ++i)
      for (int dy = -reach; dy <= reach; dy += 2 * reach)
        for (int dx = -reach; dx <= reach; dx += 2 * reach)
          set.mark((cells[i].y + dy) >> kTileBits, (cells[i].x + dx) >> kTileBits);
    set.emit(cells[first].row, out);
  }
}

}  // namespace gridslam
