#include "surfaces.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

#include "threads.hpp"

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

struct Increment {
  double x, y, theta;
};

Increment between(const double* from, const double* to) {
  const double c = std::cos(from[2]), s = std::sin(from[2]);
  const double dx = to[0] - from[0], dy = to[1] - from[1];
  return {c * dx + s * dy, c * dy - s * dx, to[2] - from[2]};
}

constexpr int64_t kLineBeside = 2;         // neighbours on either side with which a line is fitted
constexpr double kLongestGapM = 0.4;       // between neighbours on one surface
constexpr double kLongestGapRatio = 0.05;  // and for each metre of range
constexpr double kMostSpread2 = 0.0036;    // m^2, of the points about their line
constexpr double kReach2 = 900.0;          // m^2

// Whether point k and the one before it may be on one surface.
bool is_beside(const double* x, const double* y, int64_t k) {
  const double range = std::sqrt(x[k - 1] * x[k - 1] + y[k - 1] * y[k - 1]);
  const double longest = kLongestGapM + kLongestGapRatio * range, dx = x[k] - x[k - 1], dy = y[k] - y[k - 1];
  return dx * dx + dy * dy < longest * longest;
}

// Fits a line to the points at `at` and its neighbours, which are there; false where they are not in line.
bool fit_normal(const double* x, const double* y, int64_t at, double* nx, double* ny) {
  if (x[at] * x[at] + y[at] * y[at] >= kReach2) return false;
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  for (int64_t k = at - kLineBeside; k <= at + kLineBeside; ++k) mx += x[k], my += y[k];
  constexpr double count = 2 * kLineBeside + 1;
  mx /= count, my /= count;
  for (int64_t k = at - kLineBeside; k <= at + kLineBeside; ++k) {
    const double dx = x[k] - mx, dy = y[k] - my;
    xx += dx * dx, yy += dy * dy, xy += dx * dy;
  }
  const double half = 0.5 * (xx - yy);
  if (0.5 * (xx + yy) - std::sqrt(half * half + xy * xy) >= kMostSpread2) return false;
  const double along = 0.5 * std::atan2(2 * xy, xx - yy);
  *nx = -std::sin(along), *ny = std::cos(along);
  if (*nx * x[at] + *ny * y[at] > 0) *nx = -*nx, *ny = -*ny;
  return true;
}

constexpr double kMostVariance = 0.002;  // m^2, of the distances of points from a longer line
constexpr double kCorner = 4.0;          // where the variance is so much less to one side, a line ends

// A line through points: their mean, the difference and twice the product of their second moments, from which follows
// its direction, and the variance of the points' distances from it.
struct Line {
  double mx, my, difference, product, variance;
};

Line fit_line(const double* x, const double* y, int64_t first, int64_t last) {
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  const double count = static_cast<double>(last - first + 1);
  for (int64_t k = first; k <= last; ++k) mx += x[k], my += y[k];
  mx /= count, my /= count;
  for (int64_t k = first; k <= last; ++k) {
    const double dx = x[k] - mx, dy = y[k] - my;
    xx += dx * dx, yy += dy * dy, xy += dx * dy;
  }
  const double half = 0.5 * (xx - yy);
  return {mx, my, xx - yy, 2 * xy, (0.5 * (xx + yy) - std::sqrt(half * half + xy * xy)) / (count - 2)};
}

// Fits a line to the points within `reach` of point `at`, of those from `low` to `high` that are on its surface; to
// those on one side of it where there is a corner. Moves the point onto it; false where they are not in line.
bool fit_long_line(const double* x, const double* y, int64_t at, int64_t low, int64_t high, double reach, double* point,
                   double* normal) {
  constexpr int64_t kFewest = 2 * kLineBeside;  // beside the point
  if (high - low < kFewest || x[at] * x[at] + y[at] * y[at] >= kReach2) return false;
  const auto is_near = [&](int64_t k) {
    const double dx = x[k] - x[at], dy = y[k] - y[at];
    return dx * dx + dy * dy < reach * reach;
  };
  int64_t first = at, last = at;
  while (first > low && is_near(first - 1)) --first;
  while (last < high && is_near(last + 1)) ++last;
  while (last - first < kFewest) {  // the others are farther off
    if (first > low && (last == high || at - first <= last - at))
      --first;
    else
      ++last;
  }
  Line best = fit_line(x, y, first, last);
  first = std::max(low, std::min(first, at - kFewest)), last = std::min(high, std::max(last, at + kFewest));
  for (const auto& [begin, end] : {std::pair{first, at}, std::pair{at, last}}) {
    if (end - begin < kFewest) continue;
    const Line line = fit_line(x, y, begin, end);
    if (kCorner * line.variance < best.variance) best = line;
  }
  if (best.variance >= kMostVariance) return false;
  const double along = 0.5 * std::atan2(best.product, best.difference);
  double nx = -std::sin(along), ny = std::cos(along);
  if (nx * x[at] + ny * y[at] > 0) nx = -nx, ny = -ny;
  const double off = nx * (x[at] - best.mx) + ny * (y[at] - best.my);
  point[0] = x[at] - off * nx, point[1] = y[at] - off * ny, normal[0] = nx, normal[1] = ny;
  return true;
}

// Takes the direction of the position that the normal equations (upper triangle, right side, points) leave open out of
// them.
void project_on_determined(double least_information, double* sums) {
  const double half = 0.5 * (sums[0] + sums[3]);
  const double radius = std::hypot(0.5 * (sums[0] - sums[3]), sums[1]);
  const double least = least_information * sums[9];
  if (half - radius >= least) return;
  const double along = 0.5 * std::atan2(2 * sums[1], sums[0] - sums[3]);  // of the strongest direction
  const double c = std::cos(along), s = std::sin(along);
  const double strongest = half + radius < least ? 0.0 : half + radius;
  const double turn = strongest > 0 ? c * sums[2] + s * sums[4] : 0.0,
               right = strongest > 0 ? c * sums[6] + s * sums[7] : 0.0;
  sums[0] = strongest * c * c, sums[1] = strongest * c * s, sums[3] = strongest * s * s;
  sums[2] = turn * c, sums[4] = turn * s;
  sums[6] = right * c, sums[7] = right * s;
}

// Solves A x = b for a symmetric positive definite A, upper triangle row by row, by Cramer's rule.
std::array<double, 3> solve(const std::array<double, 6>& a, const std::array<double, 3>& b) {
  const double c00 = a[3] * a[5] - a[4] * a[4], c01 = a[2] * a[4] - a[1] * a[5], c02 = a[1] * a[4] - a[2] * a[3];
  const double c11 = a[0] * a[5] - a[2] * a[2], c12 = a[1] * a[2] - a[0] * a[4], c22 = a[0] * a[3] - a[1] * a[1];
  const double whole = a[0] * c00 + a[1] * c01 + a[2] * c02;
  return {(c00 * b[0] + c01 * b[1] + c02 * b[2]) / whole, (c01 * b[0] + c11 * b[1] + c12 * b[2]) / whole,
          (c02 * b[0] + c12 * b[1] + c22 * b[2]) / whole};
}

constexpr double kLeastVariance = 0.2;  // of a point across its line, to that of a beam that hits it head on
constexpr double kAlong2 = 0.04;        // m^2, of the way along a line from its point

// Of the incidence of the beam that ends at point k of a scan: its noise moves the point across its line by the cosine.
double squared_cosine(const Surfaces& surfaces, int64_t scan, int64_t k) {
  const double x = surfaces.points[2 * k] - surfaces.origins[2 * scan];
  const double y = surfaces.points[2 * k + 1] - surfaces.origins[2 * scan + 1];
  const double across = x * surfaces.normals[2 * k] + y * surfaces.normals[2 * k + 1];
  return across * across / std::max(x * x + y * y, 1e-12);
}

// Adds the normal equations of the points of scan `moved`, at a pose seen from scan `fixed`, by the pose of `to`: which
// is the moved one or the fixed one.
void add(const Surfaces& of, int64_t fixed, const Surfaces& by, int64_t moved, const Increment& pose, bool moves_to,
         double gate_m, double scale_m, bool by_incidence, double* out) {
  const double c = std::cos(pose.theta), s = std::sin(pose.theta);
  const int64_t low = of.starts[fixed], high = of.starts[fixed + 1];
  int64_t place = low;  // both scans are ordered by bearing, so that the next one is found a step or two farther
  for (int64_t k = by.starts[moved]; k < by.starts[moved + 1]; ++k) {
    const double px = by.points[2 * k], py = by.points[2 * k + 1];
    const double x = c * px - s * py + pose.x, y = s * px + c * py + pose.y;
    const double bearing = rank_bearing(x - of.origins[2 * fixed], y - of.origins[2 * fixed + 1]);
    while (place < high && of.bearings[place] < bearing) ++place;
    while (place > low && of.bearings[place - 1] >= bearing) --place;
    if (place == low || place == high) continue;  // beyond what the other scan has seen
    const int64_t first = std::max(place - kBeside, low);
    const int64_t last = std::min(place + kBeside, high);
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
    if (by.normals != nullptr) {
      const double mx = c * by.normals[2 * k] - s * by.normals[2 * k + 1];
      const double my = s * by.normals[2 * k] + c * by.normals[2 * k + 1];
      if (nx * mx + ny * my < kLeastCosine) continue;
    }
    const double residual = (x - of.points[2 * nearest]) * nx + (y - of.points[2 * nearest + 1]) * ny;
    if (std::abs(residual) > gate_m) continue;
    const double scaled = residual / scale_m;
    double variance = 1.0;
    if (by_incidence) {
      if (nearest2 - residual * residual > kAlong2) continue;
      variance = kLeastVariance + 0.5 * (squared_cosine(of, fixed, nearest) + squared_cosine(by, moved, k));
    }
    const double weight = 1.0 / (variance + scaled * scaled);
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
    out[10] += residual * residual;
  }
}

// Fits lines to the ends of one scan's beams, as `fit_surfaces` does; gives the number of points.
int64_t fit_scan(const double* ends, int64_t size, const double* origin, double reach_m, double* points,
                 double* normals, double* bearings) {
  thread_local std::vector<double> x, y, rank, ordered_x, ordered_y, ordered_rank;
  thread_local std::vector<int64_t> order;
  x.resize(size), y.resize(size), rank.resize(size);
  for (int64_t k = 0; k < size; ++k) {
    x[k] = ends[2 * k] - origin[0];
    y[k] = ends[2 * k + 1] - origin[1];
    rank[k] = rank_bearing(x[k], y[k]);
  }
  if (!std::is_sorted(rank.begin(), rank.end())) {
    order.resize(size);
    std::iota(order.begin(), order.end(), int64_t{0});
    std::stable_sort(order.begin(), order.end(), [](int64_t a, int64_t b) { return rank[a] < rank[b]; });
    ordered_x.resize(size), ordered_y.resize(size), ordered_rank.resize(size);
    for (int64_t k = 0; k < size; ++k) {
      ordered_x[k] = x[order[k]], ordered_y[k] = y[order[k]], ordered_rank[k] = rank[order[k]];
    }
    x.swap(ordered_x), y.swap(ordered_y), rank.swap(ordered_rank);
  }
  int64_t found = 0;
  int64_t low = 0, high = -1;  // of points that follow each other on one surface, without a gap
  for (int64_t k = 0; k < size; ++k) {
    if (k > high) {
      low = high = k;
      while (high + 1 < size && is_beside(x.data(), y.data(), high + 1)) ++high;
    }
    double point[2]{x[k], y[k]}, normal[2]{};
    const bool is_line = reach_m > 0 ? fit_long_line(x.data(), y.data(), k, low, high, reach_m, point, normal)
                                     : k - low >= kLineBeside && high - k >= kLineBeside &&
                                           fit_normal(x.data(), y.data(), k, normal, normal + 1);
    if (!is_line) continue;
    points[2 * found] = point[0] + origin[0], points[2 * found + 1] = point[1] + origin[1];
    normals[2 * found] = normal[0], normals[2 * found + 1] = normal[1];
    bearings[found++] = rank[k];
  }
  return found;
}

}  // namespace

void fit_surfaces(const double* ends, const int64_t* starts, const double* origins, int64_t scans, double reach_m,
                  int threads, double* points, double* normals, double* bearings, int64_t* counts) {
  parallel_for(static_cast<int>(scans), threads, [&](int scan) {
    const int64_t first = starts[scan];
    counts[scan] = fit_scan(ends + 2 * first, starts[scan + 1] - first, origins + 2 * scan, reach_m, points + 2 * first,
                            normals + 2 * first, bearings + first);
  });
}

int64_t match_to_surfaces(const Surfaces& fixed, const double* poses, int64_t count, const Surfaces& moved,
                          const SurfaceMatching& how, double* pose) {
  const std::array<double, 3> guess{pose[0], pose[1], pose[2]};
  const double weight = 0.5 / (how.scale_m * how.scale_m);
  int64_t fewest = moved.starts[1] - moved.starts[0];
  fewest *= count;
  for (int64_t step = 0; step < how.steps; ++step) {
    std::array<double, kSurfaceSums> sums{};
    for (int64_t scan = 0; scan < count; ++scan) {
      add(fixed, scan, moved, 0, between(poses + 3 * scan, pose), true, how.gates_m[step], how.scale_m, false,
          sums.data());
    }
    fewest = std::min(fewest, static_cast<int64_t>(sums[9]));
    project_on_determined(how.least_information, sums.data());
    const Increment away = between(guess.data(), pose);
    const std::array<double, 3> error{away.x, away.y, away.theta};
    std::array<double, 6> a;
    for (int64_t k = 0; k < 6; ++k) a[k] = weight * sums[k];
    a[0] += how.prior[0], a[3] += how.prior[1], a[5] += how.prior[2];
    std::array<double, 3> b;
    for (int64_t k = 0; k < 3; ++k) b[k] = weight * sums[6 + k] + how.prior[k] * error[k];
    const std::array<double, 3> move = solve(a, b);
    const double c = std::cos(pose[2]), s = std::sin(pose[2]);
    pose[0] -= c * move[0] - s * move[1];
    pose[1] -= s * move[0] + c * move[1];
    pose[2] -= move[2];
  }
  return fewest;
}

void match_surfaces(const Surfaces& surfaces, const double* poses, const int64_t* pairs, int64_t count, double gate_m,
                    double scale_m, bool both, bool by_incidence, int threads, double* out) {
  parallel_for(static_cast<int>(count), threads, [&](int p) {
    const int64_t from = pairs[2 * p], to = pairs[2 * p + 1];
    double* own = out + kSurfaceSums * p;
    std::fill(own, own + kSurfaceSums, 0.0);
    add(surfaces, from, surfaces, to, between(poses + 3 * from, poses + 3 * to), true, gate_m, scale_m, by_incidence,
        own);
    if (both) {
      add(surfaces, to, surfaces, from, between(poses + 3 * to, poses + 3 * from), false, gate_m, scale_m, by_incidence,
          own);
    }
  });
}

}  // namespace gridslam
