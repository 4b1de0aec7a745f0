#include "surfaces.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace gridslam {
namespace {

constexpr int64_t kBeside = 3;        // points on either side of a bearing among which the nearest is searched
constexpr double kNear2 = 0.25;       // m^2
constexpr double kLeastCosine = 0.9;  // of the angle between normals

// Ascends with the bearing from -pi to pi, from -2 to 2, without a call of arctan.
double rank_bearing(double x, double y) {
  const double size = std::abs(x) + std::abs(y);
  const double rank = size > 0 ? y / size : 0.0;
  return x >= 0 ? rank : (y >= 0 ? 2.0 - rank : -2.0 - rank);
}

struct Pose {
  double x, y, theta;
};

Pose between(const double* from, const double* to) {
  const double c = std::cos(from[2]), s = std::sin(from[2]);
  const double dx = to[0] - from[0], dy = to[1] - from[1];
  return {c * dx + s * dy, c * dy - s * dx, to[2] - from[2]};
}

// Adds the normal equations of the points of scan `moved`, at a pose seen from scan `fixed`, by the pose of `to`: which
// is the moved one or the fixed one.
void add(const Surfaces& of, int64_t fixed, int64_t moved, const Pose& pose, bool moves_to, double gate_m,
         double scale_m, double* out) {
  const double c = std::cos(pose.theta), s = std::sin(pose.theta);
  const double* low = of.bearings + of.starts[fixed];
  const double* high = of.bearings + of.starts[fixed + 1];
  for (int64_t k = of.starts[moved]; k < of.starts[moved + 1]; ++k) {
    const double px = of.points[2 * k], py = of.points[2 * k + 1];
    const double x = c * px - s * py + pose.x, y = s * px + c * py + pose.y;
    const double bearing = rank_bearing(x - of.origins[2 * fixed], y - of.origins[2 * fixed + 1]);
    const int64_t place = std::lower_bound(low, high, bearing) - of.bearings;
    const int64_t first = std::max(place - kBeside, of.starts[fixed]);
    const int64_t last = std::min(place + kBeside, of.starts[fixed + 1]);
    int64_t nearest = -1;
    double nearest2 = kNear2;
    for (int64_t q = first; q < last; ++q) {
      const double dx = x - of.points[2 * q], dy = y - of.points[2 * q + 1];
      if (dx * dx + dy * dy < nearest2) {
        nearest2 = dx * dx + dy * dy;
        nearest = q;
      }
    }
    if (nearest < 0) continue;
    const double nx = of.normals[2 * nearest], ny = of.normals[2 * nearest + 1];
    const double mx = c * of.normals[2 * k] - s * of.normals[2 * k + 1];
    const double my = s * of.normals[2 * k] + c * of.normals[2 * k + 1];
    if (nx * mx + ny * my < kLeastCosine) continue;
    const double residual = (x - of.points[2 * nearest]) * nx + (y - of.points[2 * nearest + 1]) * ny;
    if (std::abs(residual) > gate_m) continue;
    const double scaled = residual / scale_m;
    const double weight = 1.0 / (1.0 + scaled * scaled);
    std::array<double, 3> slope{-nx, -ny, nx * y - ny * x};
    if (moves_to) {
      const double gx = c * nx + s * ny, gy = c * ny - s * nx;
      slope = {gx, gy, gy * px - gx * py};
    }
    int64_t at = 0;
    for (int64_t a = 0; a < 3; ++a) {
      for (int64_t b = a; b < 3; ++b) out[at++] += weight * slope[a] * slope[b];
    }
    for (int64_t a = 0; a < 3; ++a) out[6 + a] += weight * slope[a] * residual;
    out[9] += 1.0;
  }
}

}  // namespace

void match_surfaces(const Surfaces& surfaces, const double* poses, const int64_t* pairs, int64_t count, double gate_m,
                    double scale_m, bool both, double* out) {
  for (int64_t p = 0; p < count; ++p) {
    const int64_t from = pairs[2 * p], to = pairs[2 * p + 1];
    double* own = out + 10 * p;
    std::fill(own, own + 10, 0.0);
    add(surfaces, from, to, between(poses + 3 * from, poses + 3 * to), true, gate_m, scale_m, own);
    if (both) add(surfaces, to, from, between(poses + 3 * to, poses + 3 * from), false, gate_m, scale_m, own);
  }
}

}  // namespace gridslam
