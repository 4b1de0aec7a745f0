// Reading the maps: distances at the ends of beams, and ranges by ray casting.

#include "field.hpp"

namespace gridslam {

void distances(const Maps& m, const int32_t* rows, const double* poses, int k, const double* ends, int b,
               double resolution, double reach_cells, int threads, float* out) {
  const Ends in_cells(ends, b, 1.0 / resolution);
  const float reach_m = static_cast<float>(reach_cells * resolution), to_m = reach_m / 255.0f;
  parallel_for(k, threads, [&](int i) {
    const CellPose pose(poses[3 * i] / resolution, poses[3 * i + 1] / resolution, poses[3 * i + 2]);
    float* row = out + static_cast<int64_t>(i) * b;
    thread_local View view;
    view.of(m, m.root(rows[i]), pose, in_cells);
    for (int j = 0; j < b; ++j) row[j] = reach_m - to_m * interpolate(view.corners[j], view.a[j], view.b[j]).value;
  });
}

void known_cells(const Maps& m, int row, const double* pose, const double* points, int b, double resolution,
                 bool* out) {
  const Pose at(pose);
  const double scale = 1.0 / resolution;
  for (int j = 0; j < b; ++j)
    out[j] = !m.is_unknown(m.root(row), cell_of(at.world_y(points + 2 * j), scale),
                           cell_of(at.world_x(points + 2 * j), scale));
}

namespace {

constexpr double kMostRayCells = 1 << 24;  // of a ray that comes from far away; 840 km in cells of 5 cm

// How far a ray is followed: to where it has left the tables, but for rounding, beyond which nothing is occupied.
double reach_of(const Maps& m, double x, double y, double dx, double dy, double resolution, double max_m) {
  const double side = kPage * kTile * resolution;
  const double step_m = resolution / std::max({std::abs(dx), std::abs(dy), 1e-300});
  double reach = std::min(max_m, kMostRayCells * step_m);
  const auto leave = [&](double at, double direction, int page, int pages) {
    if (direction == 0) return;
    const double end = direction > 0 ? (page + pages + 1) * side : (page - 1) * side;
    reach = std::min(reach, (end - at) / direction);
  };
  leave(x, dx, m.page_col0, m.page_cols);
  leave(y, dy, m.page_row0, m.page_rows);
  return reach;
}

// Follows the cells that the ray crosses (Amanatides and Woo 1987) to the first occupied one.
float cast(const Maps& m, const int32_t* root, double x, double y, double dx, double dy, double resolution,
           double max_m) {
  const double far = std::numeric_limits<double>::infinity(), scale = 1.0 / resolution;
  if (!(std::abs(x * scale) <= kFarthest && std::abs(y * scale) <= kFarthest && std::isfinite(dx) && std::isfinite(dy)))
    return static_cast<float>(max_m);  // nothing is mapped there
  int cx = cell_of(x, scale), cy = cell_of(y, scale);
  const int sx = dx > 0 ? 1 : -1, sy = dy > 0 ? 1 : -1;
  const double step_x = dx != 0 ? resolution / std::abs(dx) : far, step_y = dy != 0 ? resolution / std::abs(dy) : far;
  double next_x = dx != 0 ? ((cx + (sx > 0)) * resolution - x) / dx : far;
  double next_y = dy != 0 ? ((cy + (sy > 0)) * resolution - y) / dy : far;
  const double reach = reach_of(m, x, y, dx, dy, resolution, max_m);
  for (double t = 0; t < reach;) {
    if (m.field_at(root, cy, cx) == kOccupiedField) {
      const double centre = ((cx + 0.5) * resolution - x) * dx + ((cy + 0.5) * resolution - y) * dy;
      return static_cast<float>(std::clamp(centre, 0.0, max_m));  // where the ray passes the cell's centre
    }
    if (next_x < next_y) {
      t = next_x, next_x += step_x, cx += sx;
    } else {
      t = next_y, next_y += step_y, cy += sy;
    }
  }
  return static_cast<float>(max_m);
}

}  // namespace

void cast_rays(const Maps& m, const int32_t* rows, const double* poses, int k, const double* origin,
               const double* directions, int b, double resolution, double max_m, int threads, float* out) {
  parallel_for(k, threads, [&](int i) {
    const Pose pose(poses + 3 * i);
    const double x = pose.world_x(origin), y = pose.world_y(origin);
    for (int j = 0; j < b; ++j) {
      const double dx = pose.c * directions[2 * j] - pose.s * directions[2 * j + 1];
      const double dy = pose.s * directions[2 * j] + pose.c * directions[2 * j + 1];
      out[static_cast<int64_t>(i) * b + j] = cast(m, m.root(rows[i]), x, y, dx, dy, resolution, max_m);
    }
  });
}

}  // namespace gridslam
