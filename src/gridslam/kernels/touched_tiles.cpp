// Which tiles a step will write to: found in parallel, nothing is written here.

#include "rays.hpp"

namespace gridslam {
namespace {

GRIDSLAM_VERSIONS void cells(const Pose& pose, const double* ends, int b, double scale, int* xs, int* ys) {
  for (int j = 0; j < b; ++j)
    xs[j] = cell_of(pose.world_x(ends + 2 * j), scale), ys[j] = cell_of(pose.world_y(ends + 2 * j), scale);
}

void emit(const TileSet& set, int row, TileList& out) {
  set.each([&](int ty, int tx) { out.push_back({row, ty, tx}); });
}

}  // namespace

void Fan::cells_of(const Pose& pose, const double* ends, int b, double scale, int* xs, int* ys) {
  cells(pose, ends, b, scale, xs, ys);
}

void tiles_on_rays(const int32_t* rows, const double* poses, int k, const double* ends, int b, const double* origin,
                   double resolution, int threads, TileList& out) {
  std::vector<TileList> found(k);
  parallel_for(k, threads, [&](int i) {
    emit(Fan(Pose(poses + 3 * i), ends, b, origin, 1.0 / resolution).tiles(), rows[i], found[i]);
  });
  for (const auto& part : found) out.insert(out.end(), part.begin(), part.end());
}

void tiles_near_cells(const Cell* cells, int n, int reach, TileList& out) {
  for (int first = 0, last; first < n; first = last) {  // cells come grouped by row
    int y_min = cells[first].y, y_max = y_min, x_min = cells[first].x, x_max = x_min;
    for (last = first; last < n && cells[last].row == cells[first].row; ++last) {
      y_min = std::min(y_min, cells[last].y), y_max = std::max(y_max, cells[last].y);
      x_min = std::min(x_min, cells[last].x), x_max = std::max(x_max, cells[last].x);
    }
    TileSet set((y_min - reach) >> kTileBits, (y_max + reach) >> kTileBits, (x_min - reach) >> kTileBits,
                (x_max + reach) >> kTileBits);
    for (int i = first; i < last; ++i)
      for (int dy = -reach; dy <= reach; dy += 2 * reach)
        for (int dx = -reach; dx <= reach; dx += 2 * reach)
          set.mark((cells[i].y + dy) >> kTileBits, (cells[i].x + dx) >> kTileBits);
    emit(set, cells[first].row, out);
  }
}

}  // namespace gridslam
