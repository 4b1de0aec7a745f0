// Surfaces that scans see, as points with normals, and how well those of two scans fit.
#pragma once

#include <cstdint>

#include "maps.hpp"

namespace gridslam {

// Points of scans, ascending by bearing from each scan's laser.
struct Surfaces {
  const double* points;    // (B, 2), base frame
  const double* normals;   // (B, 2), toward the laser; null where none is known, so that all lines will do
  const double* bearings;  // (B,), ranks of bearings
  const int64_t* starts;   // (S + 1,)
  const double* origins;   // (S, 2)
};

constexpr int64_t kSurfaceSums = 11;

// For each pair `from`, `to` of scans at poses (S, 3): the upper triangle of the normal equations' matrix, the right
// side, the number of matched points and the sum of their squared residuals; see `reference_surfaces`.
void match_surfaces(const Surfaces& surfaces, const double* poses, const int64_t* pairs, int64_t count, double gate_m,
                    double scale_m, bool both, bool by_incidence, int threads, double* out);

// Points with normals of scans of which the beams end at `ends` (B, 2): where neighbouring beams end on a line. Writes
// points, normals, ranks of bearings, each of room for B, those of a scan from where its beams begin, and their numbers
// (scans,); see `reference_surfaces`.
void fit_surfaces(const double* ends, const int64_t* starts, const double* origins, int64_t scans, double reach_m,
                  int threads, double* points, double* normals, double* bearings, int64_t* counts);

// How a scan is matched to the surfaces of others, by Gauss-Newton.
struct SurfaceMatching {
  const double* prior;    // (3,), information of the guess, in the frame of the scan
  const double* gates_m;  // largest residual, in each step
  int64_t steps;
  double scale_m;
  double least_information;
};

// Moves `pose` (3,), where scan 0 of `moved` is, to where its ends fit lines of the `count` scans of `fixed` at
// `poses`; gives the number of points matched in the step where they were the fewest.
int64_t match_to_surfaces(const Surfaces& fixed, const double* poses, int64_t count, const Surfaces& moved,
                          const SurfaceMatching& how, double* pose);

}  // namespace gridslam
