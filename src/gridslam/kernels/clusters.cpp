// Many particles: resampled, on free cells or not, and their densest cluster.

#include "clusters.hpp"

#include <cmath>

namespace gridslam {
namespace {

struct Away {
  double x, y, turn;
};

GRIDSLAM_INLINE Away seen_from(const double* centre, const double* pose) {
  double turn = pose[2] - centre[2];  // of two angles in [-pi, pi): at most one turn too far
  if (turn >= kPi) turn -= 2 * kPi;
  if (turn < -kPi) turn += 2 * kPi;
  return {pose[0] - centre[0], pose[1] - centre[1], turn};
}

}  // namespace

// Poses that do not count have no weight: a sum without branches is faster, and the same.
GRIDSLAM_VERSIONS ClusterMoments mean_shift(const double* poses, const double* weights, const bool* first, int64_t n,
                                            const Cluster& c, double* centre) {
  for (int shift = 0; shift < c.shifts; ++shift) {
    double mass = 0, x = 0, y = 0, turn = 0;
    for (int64_t i = 0; i < n; ++i) {
      const Away away = seen_from(centre, poses + 3 * i);
      const double weight = (shift == 0 ? first[i] : c.holds(away.x, away.y, away.turn)) ? weights[i] : 0;
      mass += weight, x += weight * away.x, y += weight * away.y, turn += weight * away.turn;
    }
    centre[0] += x / mass, centre[1] += y / mass, centre[2] += turn / mass;
    if (centre[2] >= kPi) centre[2] -= 2 * kPi;
    if (centre[2] < -kPi) centre[2] += 2 * kPi;
  }
  ClusterMoments near, all;
  for (int64_t i = 0; i < n; ++i) {
    const Away away = seen_from(centre, poses + 3 * i);
    near.add(away.x, away.y, away.turn, c.holds(away.x, away.y, away.turn) ? weights[i] : 0);
  }
  near.cluster_mass = all.cluster_mass = near.mass;
  if (near.mass > 0.5) return near;
  for (int64_t i = 0; i < n; ++i) {
    const Away away = seen_from(centre, poses + 3 * i);
    all.add(away.x, away.y, away.turn, weights[i]);
  }
  return all;
}

void slots_of(const double* ends, int64_t n, const double* points, int64_t m, int64_t* out) {
  int64_t slot = 0;
  for (int64_t i = 0; i < m; ++i) {
    while (slot < n && ends[slot] <= points[i]) ++slot;
    out[i] = slot;
  }
}

GRIDSLAM_VERSIONS void are_true(const bool* mask, int64_t rows, int64_t columns, const double* corner,
                                double inverse_resolution, const double* poses, int64_t n, bool* out) {
  for (int64_t i = 0; i < n; ++i) {
    const double column = std::floor((poses[3 * i] - corner[0]) * inverse_resolution);
    const double row = std::floor((poses[3 * i + 1] - corner[1]) * inverse_resolution);
    const bool inside = column >= 0 && row >= 0 && column < static_cast<double>(columns) &&
                        row < static_cast<double>(rows);  // a NaN is not
    out[i] = inside && mask[static_cast<int64_t>(row) * columns + static_cast<int64_t>(column)];
  }
}

}  // namespace gridslam
