// Which tiles a step will write to: found in parallel, nothing is written here.

#include "rays.hpp"

namespace gridslam {
namespace {

GRIDSLAM_VERSIONS void lines(const Pose& pose, const double* GRIDSLAM_RESTRICT ends, int b, double scale, int x0,
                             int y0, int* GRIDSLAM_RESTRICT xs, int* GRIDSLAM_RESTRICT ys,
                             double* GRIDSLAM_RESTRICT slopes) {
  const Pose at = pose;
  for (int j = 0; j < b; ++j) {
    const int x = cell_of(at.world_x(ends + 2 * j), scale), y = cell_of(at.world_y(ends + 2 * j), scale);
    xs[j] = x, ys[j] = y;
    slopes[j] = Line::slope_of(x - x0, y - y0);
  }
}

// Marks the tiles in which a line frees cells, and that of its end. The minor axis is monotone, and within a tile's
// width it crosses one border at most: the first and the last cell there are enough.
void mark(const Line& line, TileSet& set) {
  const int most = line.n <= kFreeCells ? line.n : kFreeCells - 1;
  if (most < line.n) {
    const int end = line.major(line.n) >> kTileBits, aside = line.minor(line.n) >> kTileBits;
    line.along_x ? set.mark(aside, end) : set.mark(end, aside);
  }
  const int major = line.major(0), minor = line.minor(0), inside = major & kTileMask;
  const ptrdiff_t across = line.along_x ? set.cols : 1, along = line.major_step * (line.along_x ? 1 : set.cols);
  ptrdiff_t first =
      line.along_x ? set.index(0, major >> kTileBits) : set.index(major >> kTileBits, 0);  // by minor tile
  const auto touch = [&](uint64_t aside) {
    set.mark_at(first + ((minor + static_cast<int>(aside >> 32) * line.minor_step) >> kTileBits) * across);
  };
  uint64_t aside = line.start;
  int left = most, steps = line.major_step > 0 ? kTileMask - inside : inside;  // to the last cell in the tile
  for (; left > steps; left -= steps + 1, steps = kTileMask, first += along) {
    touch(aside);
    aside += static_cast<uint64_t>(steps) * line.slope;
    touch(aside);
    aside += line.slope;
  }
  touch(aside);
  touch(aside + static_cast<uint64_t>(left) * line.slope);
}

}  // namespace

void Fan::see(const Pose& pose, const double* ends, int b, const double* origin, double scale) {
  x = cell_of(pose.world_x(origin), scale), y = cell_of(pose.world_y(origin), scale);
  xs.resize(b), ys.resize(b), slopes.resize(b);
  lines(pose, ends, b, scale, x, y, xs.data(), ys.data(), slopes.data());
}

void Fan::tiles(TileSet& set) const {
  int x_min = x, x_max = x, y_min = y, y_max = y;
  for (size_t j = 0; j < xs.size(); ++j) {
    x_min = std::min(x_min, xs[j]), x_max = std::max(x_max, xs[j]);
    y_min = std::min(y_min, ys[j]), y_max = std::max(y_max, ys[j]);
  }
  set.reset(y_min >> kTileBits, y_max >> kTileBits, x_min >> kTileBits, x_max >> kTileBits);
  for (size_t j = 0; j < xs.size(); ++j)
    if (j == 0 || xs[j] != xs[j - 1] || ys[j] != ys[j - 1]) mark(line(j), set);
}

void tiles_on_rays(const int32_t* rows, const double* poses, int k, const double* ends, int b, const double* origin,
                   double resolution, int threads, TileList& out) {
  std::vector<TileList> found(k);
  parallel_for(k, threads, [&](int i) {
    Fan fan;
    TileSet set;
    fan.see(Pose(poses + 3 * i), ends, b, origin, 1.0 / resolution);
    fan.tiles(set);
    set.each([&](int ty, int tx) { found[i].push_back({rows[i], ty, tx}); });
  });
  for (const auto& part : found) out.insert(out.end(), part.begin(), part.end());
}

void tiles_near_cells(const Cell* cells, int n, int reach, TileSet& set) {
  int y_min = cells->y, y_max = y_min, x_min = cells->x, x_max = x_min;
  for (int i = 1; i < n; ++i) {
    y_min = std::min(y_min, cells[i].y), y_max = std::max(y_max, cells[i].y);
    x_min = std::min(x_min, cells[i].x), x_max = std::max(x_max, cells[i].x);
  }
  set.reset((y_min - reach) >> kTileBits, (y_max + reach) >> kTileBits, (x_min - reach) >> kTileBits,
            (x_max + reach) >> kTileBits);
  for (int i = 0; i < n; ++i)
    for (int dy = -reach; dy <= reach; dy += 2 * reach)
      for (int dx = -reach; dx <= reach; dx += 2 * reach)
        set.mark((cells[i].y + dy) >> kTileBits, (cells[i].x + dx) >> kTileBits);
}

}  // namespace gridslam
