// Surfaces that scans see, as points with normals, and how well those of two scans fit.
#pragma once

#include <cstdint>

#include "maps.hpp"

namespace gridslam {

// Points of scans, ascending by bearing from each scan's laser.
struct Surfaces {
  const double* points;    // (B, 2), base frame
  const double* normals;   // (B, 2), toward the laser
  const double* bearings;  // (B,), ranks of bearings
  const int64_t* starts;   // (S + 1,)
  const double* origins;   // (S, 2)
};

// For each pair `from`, `to` of scans at poses (S, 3): the upper triangle of the normal equations' matrix, the right
// side and the number of matched points, (P, 10); see `reference_surfaces`.
void match_surfaces(const Surfaces& surfaces, const double* poses, const int64_t* pairs, int64_t count, double gate_m,
                    double scale_m, bool both, double* out);

}  // namespace gridslam
