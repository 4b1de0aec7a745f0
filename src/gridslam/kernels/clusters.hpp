// Many particles: resampled, on free cells or not, and their densest cluster.
#pragma once

#include <cmath>
#include <cstdint>

#include "maps.hpp"

namespace gridslam {

struct Cluster {
  double radius_m, radius_rad;
  int shifts;  // towards the mean of what is near
  GRIDSLAM_INLINE bool holds(double x, double y, double turn) const {
    return x * x + y * y < radius_m * radius_m && std::abs(turn) < radius_rad;
  }
};

// Sums over poses as seen from a centre.
struct ClusterMoments {
  double mass = 0, mass_of_squares = 0, cluster_mass = 0;
  double xx = 0, xy = 0, xt = 0, yy = 0, yt = 0, tt = 0;
  GRIDSLAM_INLINE void add(double x, double y, double turn, double weight) {
    mass += weight, mass_of_squares += weight * weight;
    xx += weight * x * x, xy += weight * x * y, xt += weight * x * turn;
    yy += weight * y * y, yt += weight * y * turn, tt += weight * turn * turn;
  }
};

ClusterMoments mean_shift(const double* poses, const double* weights, const bool* first, int64_t n, const Cluster& c,
                          double* centre);
void slots_of(const double* ends, int64_t n, const double* points, int64_t m, int64_t* out);
void are_true(const bool* mask, int64_t rows, int64_t columns, const double* corner, double inverse_resolution,
              const double* poses, int64_t n, bool* out);

}  // namespace gridslam
