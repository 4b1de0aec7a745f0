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

void mark(const Line& line, TileSet& set) {
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

}  // namespace

void Fan::see(const Pose& pose, const double* ends, int b, const double* origin, double scale) {
  x = cell_of(pose.world_x(origin), scale), y = cell_of(pose.world_y(origin), scale);
  xs.resize(b), ys.resize(b), slopes.resize(b);
  lines(pose, ends, b, scale, x, y, xs.data(), ys.data(), slopes.data());
}

TileBox Fan::box() const {
  int x_min = x, x_max = x, y_min = y, y_max = y;
  for (size_t j = 0; j < xs.size(); ++j) {
    x_min = std::min(x_min, xs[j]), x_max = std::max(x_max, xs[j]);
    y_min = std::min(y_min, ys[j]), y_max = std::max(y_max, ys[j]);
  }
  return {y_min >> kTileBits, y_max >> kTileBits, x_min >> kTileBits, x_max >> kTileBits};
}

void Fan::tiles(TileSet& set) const {
  const TileBox about = box();
  set.reset(about.y0, about.y1, about.x0, about.x1);
  for (size_t j = 0; j < xs.size(); ++j) mark(line(j), set);
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
