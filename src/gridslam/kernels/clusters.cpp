// The densest cluster of weighted poses, and which of them stand on free cells.

#include "clusters.hpp"

#include <cmath>
#include <limits>
#include <numbers>

namespace gridslam {
namespace {

constexpr double kPi = std::numbers::pi;

struct Away {
  double x, y, turn;
};

Away seen_from(const double* centre, const double* pose) {
  double turn = pose[2] - centre[2];  // of two angles in [-pi, pi): at most one turn too far
  if (turn >= kPi) turn -= 2 * kPi;
  if (turn < -kPi) turn += 2 * kPi;
  return {pose[0] - centre[0], pose[1] - centre[1], turn};
}

}  // namespace

ClusterMoments mean_shift(const double* poses, const double* weights, const bool* first, int64_t n, const Cluster& c,
                          double* centre) {
  for (int shift = 0; shift < c.shifts; ++shift) {
    double mass = 0, x = 0, y = 0, turn = 0;
    for (int64_t i = 0; i < n; ++i) {
      const Away away = seen_from(centre, poses + 3 * i);
      if (shift == 0 ? !first[i] : !c.holds(away.x, away.y, away.turn)) continue;
      mass += weights[i], x += weights[i] * away.x, y += weights[i] * away.y, turn += weights[i] * away.turn;
    }
    centre[0] += x / mass, centre[1] += y / mass, centre[2] += turn / mass;
    if (centre[2] >= kPi) centre[2] -= 2 * kPi;
    if (centre[2] < -kPi) centre[2] += 2 * kPi;
  }
  ClusterMoments all, near;
  for (int64_t i = 0; i < n; ++i) {
    const Away away = seen_from(centre, poses + 3 * i);
    all.add(away.x, away.y, away.turn, weights[i]);
    if (c.holds(away.x, away.y, away.turn)) near.add(away.x, away.y, away.turn, weights[i]);
  }
  ClusterMoments found = near.mass > 0.5 ? near : all;
  found.cluster_mass = near.mass;
  return found;
}

void are_true(const bool* mask, int64_t rows, int64_t columns, const double* corner, double inverse_resolution,
              const double* poses, int64_t n, bool* out) {
  for (int64_t i = 0; i < n; ++i) {
    const double column = std::floor((poses[3 * i] - corner[0]) * inverse_resolution);
    const double row = std::floor((poses[3 * i + 1] - corner[1]) * inverse_resolution);
    const bool inside = column >= 0 && row >= 0 && column < static_cast<double>(columns) &&
                        row < static_cast<double>(rows);  // a NaN is not
    out[i] = inside && mask[static_cast<int64_t>(row) * columns + static_cast<int64_t>(column)];
  }
}

}  // namespace gridslam
