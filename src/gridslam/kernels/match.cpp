// Gauss-Newton of a scan on the distance field, robustified by Cauchy weights; one independent problem for each guess.

#include <bit>

#include "field.hpp"

namespace gridslam {
namespace {

struct Normal {  // of sum w d^2 in cells and radians: H = [h00 h01 h02; . h11 h12; . . h22]
  double h00 = 0, h01 = 0, h02 = 0, h11 = 0, h12 = 0, h22 = 0, g0 = 0, g1 = 0, g2 = 0, score = 0;
};

// clang-format off
enum Sum { kH00, kH01, kH02, kH11, kH12, kH22, kG0, kG1, kG2, kScore, kSums };
// clang-format on

// How many ends apart those are that must lie on a line with each of n ends: kBase cells, by the farther neighbour.
GRIDSLAM_VERSIONS void strides_of(const float* GRIDSLAM_RESTRICT ex, const float* GRIDSLAM_RESTRICT ey, int n,
                                  float* GRIDSLAM_RESTRICT gap, int32_t* GRIDSLAM_RESTRICT stride) {
  constexpr float kBase = 6.0f;
  gap[0] = gap[n] = 0.0f;  // gap[i] is that between ends i - 1 and i
  for (int i = 1; i < n; ++i) {
    const float dx = ex[i] - ex[i - 1], dy = ey[i] - ey[i - 1];
    gap[i] = std::sqrt(dx * dx + dy * dy);
  }
  const float most = static_cast<float>(n);
  for (int i = 0; i < n; ++i) {
    const float ends = kBase / std::max(gap[i], gap[i + 1]), count = std::min(ends, most);
    const int whole = static_cast<int>(count), up = whole + (static_cast<float>(whole) < count);
    stride[i] = std::max(1, up);
  }
}

// Takes the walls on which end i is the one at `first` strides, of three, where none is known yet.
GRIDSLAM_VERSIONS void walls_on(const float* GRIDSLAM_RESTRICT ex, const float* GRIDSLAM_RESTRICT ey,
                                const int32_t* GRIDSLAM_RESTRICT stride, int n, int first, float* GRIDSLAM_RESTRICT x,
                                float* GRIDSLAM_RESTRICT y, float* GRIDSLAM_RESTRICT along) {
  constexpr float kAside = 0.6f;  // cells: more than a lidar scatters; walls that scatter more are not straight
  for (int i = 0; i < n; ++i) {
    const int from = i + first * stride[i], to = from + 2 * stride[i];
    const int a = std::max(from, 0), b = std::min(to, n - 1), m = std::min(a + stride[i], n - 1);
    const float ux = ex[m] - ex[a], uy = ey[m] - ey[a], vx = ex[b] - ex[m], vy = ey[b] - ey[m];
    const float cx = ux + vx, cy = uy + vy, length = std::sqrt(cx * cx + cy * cy);
    const int inside = static_cast<int>(from >= 0) & static_cast<int>(to < n);
    const int onward = static_cast<int>(ux * vx + uy * vy > 0);
    const int near = static_cast<int>(std::abs(ux * cy - uy * cx) <= kAside * length);
    const bool found = (inside & onward & near & static_cast<int>(along[i] != 0.0f)) != 0;
    const float nx = -cy / length, ny = cx / length;
    x[i] = found ? nx : x[i], y[i] = found ? ny : y[i], along[i] = found ? 0.0f : along[i];
  }
}

// Normals of the straight walls on which ends lie, in the frame of the ends, (0, 0) where they lie on none, and then
// `along` is 1.
struct Walls {
  std::vector<float> x, y, along;
  Walls(const Ends& ends, bool point_to_line) : x(ends.x.size(), 0.0f), y(x), along(x.size(), 1.0f) {
    if (!point_to_line || ends.n == 0) return;
    std::vector<float> gap(ends.n + 1);
    std::vector<int32_t> stride(ends.n);
    strides_of(ends.x.data(), ends.y.data(), ends.n, gap.data(), stride.data());
    for (const int first : {-1, -2, 0})  // the end itself is the middle of three, or the last, or the first
      walls_on(ends.x.data(), ends.y.data(), stride.data(), ends.n, first, x.data(), y.data(), along.data());
  }
};

// What one scan's ends contribute, from one pose: memory that the passes of a match share.
struct Residuals {
  View view;
  std::vector<float> value, ju, jv, beyond;
  std::vector<int32_t> asked;
  std::vector<uint32_t> kept;  // bits of theirs: all where the cell is known, or none
  void resize(size_t n) {
    if (value.size() >= n) return;
    for (auto* part : {&value, &ju, &jv, &beyond}) part->resize(n);
    asked.resize(n), kept.resize(n);
  }
};

// The field at n ends and its gradient, across the wall alone where an end lies on one; `beyond` is positive where the
// gradient leans far from the wall's normal.
GRIDSLAM_VERSIONS void differentiate(const uint32_t* GRIDSLAM_RESTRICT corners, const float* GRIDSLAM_RESTRICT a,
                                     const float* GRIDSLAM_RESTRICT b, const float* GRIDSLAM_RESTRICT wx,
                                     const float* GRIDSLAM_RESTRICT wy, const float* GRIDSLAM_RESTRICT along, float c,
                                     float s, int n, float to_cells, float* GRIDSLAM_RESTRICT value,
                                     float* GRIDSLAM_RESTRICT ju, float* GRIDSLAM_RESTRICT jv,
                                     float* GRIDSLAM_RESTRICT beyond) {
  constexpr float kBeyond = 3.0f;  // the gradient leans 55 degrees from the wall's normal
  for (int j = 0; j < n; ++j) {
    const Value f = interpolate(corners[j], a[j], b[j]);
    const float gu = -to_cells * f.du, gv = -to_cells * f.dv;
    const float nx = c * wx[j] - s * wy[j], ny = s * wx[j] + c * wy[j];
    const float across = gu * nx + gv * ny;
    value[j] = f.value;
    beyond[j] = (nx * nx + ny * ny) * (gu * gu + gv * gv) - kBeyond * across * across;
    ju[j] = across * nx + along[j] * gu, jv[j] = across * ny + along[j] * gv;
  }
}

// A wall goes on where it is not mapped yet: its mapped part's end, the nearest there, is not informative.
void ignore_beyond(const Maps& m, const int32_t* root, int n, Residuals& r) {
  int32_t* asked = r.asked.data();
  const float* beyond = r.beyond.data();
  int count = 0;
  for (int j = 0; j < n; ++j) asked[count] = j, count += beyond[j] > 0;  // without a branch: they are scattered
  for (int i = 0; i < count; ++i)  // no branch waits for a cell, so that many are on their way from memory at once
    r.kept[i] = static_cast<uint32_t>(m.is_unknown(root, r.view.end_y(asked[i]), r.view.end_x(asked[i]))) - 1;
  const auto keep = [](float& value, uint32_t bits) {
    value = std::bit_cast<float>(std::bit_cast<uint32_t>(value) & bits);
  };
  for (int i = 0; i < count; ++i) keep(r.ju[asked[i]], r.kept[i]), keep(r.jv[asked[i]], r.kept[i]);
}

GRIDSLAM_VERSIONS Normal add_up(const Residuals& r, int n, int filled, float reach, float to_cells,
                                float inverse_square) {
  float sums[kSums][kLanes] = {};  // lane by lane in a fixed order: identical results for any instruction set
  const float *rx = r.view.rx.data(), *ry = r.view.ry.data(), *value = r.value.data(), *ju = r.ju.data(),
              *jv = r.jv.data();
  for (int first = 0; first < n; first += kLanes) {
    for (int l = 0; l < kLanes; ++l) {
      const int j = first + l;
      const float d = reach - to_cells * value[j];
      const float w = (j < filled ? 1.0f : 0.0f) / (1.0f + d * d * inverse_square);
      const float jt = jv[j] * rx[j] - ju[j] * ry[j];
      const float wu = w * ju[j], wv = w * jv[j], wt = w * jt;
      sums[kH00][l] += wu * ju[j], sums[kH01][l] += wu * jv[j], sums[kH02][l] += wu * jt;
      sums[kH11][l] += wv * jv[j], sums[kH12][l] += wv * jt, sums[kH22][l] += wt * jt;
      sums[kG0][l] += wu * d, sums[kG1][l] += wv * d, sums[kG2][l] += wt * d;
      sums[kScore][l] += w;
    }
  }
  double total[kSums] = {};
  for (int i = 0; i < kSums; ++i)
    for (int l = 0; l < kLanes; ++l) total[i] += sums[i][l];
  return {total[kH00], total[kH01], total[kH02], total[kH11], total[kH12],
          total[kH22], total[kG0],  total[kG1],  total[kG2],  total[kScore]};
}

Normal linearize(const Maps& m, const int32_t* root, double x, double y, double theta, const Ends& ends,
                 const Walls& walls, const MatchSettings& s) {
  thread_local Residuals r;
  const CellPose pose(x, y, theta);
  const float reach = static_cast<float>(s.reach_cells), to_cells = reach / 255.0f;
  const float inverse_square = static_cast<float>(1.0 / (s.cauchy_cells * s.cauchy_cells));
  const int n = ends.blocks * kLanes;
  r.view.of(m, root, pose, ends);
  r.resize(static_cast<size_t>(n));
  differentiate(r.view.corners.data(), r.view.a.data(), r.view.b.data(), walls.x.data(), walls.y.data(),
                walls.along.data(), pose.c, pose.s, n, to_cells, r.value.data(), r.ju.data(), r.jv.data(),
                r.beyond.data());
  if (s.point_to_line) ignore_beyond(m, root, n, r);
  return add_up(r, n, ends.n, reach, to_cells, inverse_square);
}

// Pins the position along a degenerate direction (a corridor's axis) to the guess.
void pin_degenerate(const Normal& n, const MatchSettings& s, double h[6]) {
  const double t = n.h22 > 0 ? 1.0 / n.h22 : 0.0;
  const double a = n.h00 - n.h02 * n.h02 * t, b = n.h01 - n.h02 * n.h12 * t, c = n.h11 - n.h12 * n.h12 * t;
  const double mean = 0.5 * (a + c), half = std::sqrt(0.25 * (a - c) * (a - c) + b * b),
               least = s.min_information * n.score;
  constexpr double kHold = 1e6;
  if (mean + half < least) {
    h[0] += kHold, h[3] += kHold;
  } else if (mean - half < least) {
    const double angle = 0.5 * std::atan2(2 * b, a - c), ex = -std::sin(angle), ey = std::cos(angle);
    h[0] += kHold * ex * ex, h[1] += kHold * ex * ey, h[3] += kHold * ey * ey;
  }
}

// Solves the symmetric 3 x 3 system by Cholesky; false where it is not positive definite.
bool solve(const double h[6], const double g[3], double step[3]) {
  const double l00 = std::sqrt(h[0]);
  if (!(l00 > 1e-9)) return false;
  const double l10 = h[1] / l00, l20 = h[2] / l00;
  const double l11 = std::sqrt(h[3] - l10 * l10);
  if (!(l11 > 1e-9)) return false;
  const double l21 = (h[4] - l20 * l10) / l11;
  const double l22 = std::sqrt(h[5] - l20 * l20 - l21 * l21);
  if (!(l22 > 1e-9)) return false;
  const double y0 = g[0] / l00, y1 = (g[1] - l10 * y0) / l11, y2 = (g[2] - l20 * y0 - l21 * y1) / l22;
  step[2] = y2 / l22;
  step[1] = (y1 - l21 * step[2]) / l11;
  step[0] = (y0 - l10 * step[1] - l20 * step[2]) / l00;
  return true;
}

double wrapped(double a) { return a - 2 * kPi * std::floor((a + kPi) / (2 * kPi)); }

void match_one(const Maps& m, int row, const double* guess, const double* prior, const Ends& ends, const Walls& walls,
               double resolution, const MatchSettings& s, double* pose, double* information, double* score) {
  const int passes = ends.n < s.min_ends ? 0 : s.max_iterations;
  const double scale = 1.0 / resolution;
  // The prior weighs against residuals in metres, and both are divided by the squared resolution here.
  const double p[6] = {prior[0], prior[1], prior[2] * scale, prior[4], prior[5] * scale, prior[8] * scale * scale};
  const double x0 = guess[0] * scale, y0 = guess[1] * scale;
  double x = x0, y = y0, theta = guess[2];
  const int32_t* root = m.root(row);
  Normal n;
  bool current = false;
  for (int pass = 0; pass < passes; ++pass) {
    n = linearize(m, root, x, y, theta, ends, walls, s);
    current = true;
    double h[6] = {p[0], p[1], p[2], p[3], p[4], p[5]};
    pin_degenerate(n, s, h);
    const double ex = x - x0, ey = y - y0, et = theta - guess[2];
    const double g[3] = {n.g0 + h[0] * ex + h[1] * ey + h[2] * et, n.g1 + h[1] * ex + h[3] * ey + h[4] * et,
                         n.g2 + h[2] * ex + h[4] * ey + h[5] * et};
    h[0] += n.h00, h[1] += n.h01, h[2] += n.h02, h[3] += n.h11, h[4] += n.h12, h[5] += n.h22;
    double step[3];
    if (!solve(h, g, step)) break;
    const double length = std::hypot(step[0], step[1]),
                 shorter = length > s.max_step_cells ? s.max_step_cells / length : 1.0;
    const double turn = std::clamp(step[2], -s.max_step_rad, s.max_step_rad);
    x -= shorter * step[0], y -= shorter * step[1], theta -= turn;
    current = false;
    if (length < s.stop_cells && std::abs(step[2]) < s.stop_rad) break;
  }
  if (!current) n = linearize(m, root, x, y, theta, ends, walls, s);
  pose[0] = x * resolution, pose[1] = y * resolution, pose[2] = wrapped(theta);
  *score = n.score;
  const double squared = resolution * resolution;  // of residuals in m: a metre across a wall is a metre of distance
  information[0] = n.h00, information[4] = n.h11, information[8] = n.h22 * squared;
  information[1] = information[3] = n.h01;
  information[2] = information[6] = n.h02 * resolution;
  information[5] = information[7] = n.h12 * resolution;
}

// The first of successive ends that lie in one square of this side.
std::vector<double> thin(const double* ends, int b, double side) {
  std::vector<double> kept;
  kept.reserve(2 * b);
  double column = std::nan(""), row = column;  // the square of the end before
  for (int j = 0; j < b; ++j) {
    const double x = ends[2 * j], y = ends[2 * j + 1];
    const double own_column = std::floor(x / side), own_row = std::floor(y / side);
    if (own_column != column || own_row != row) kept.insert(kept.end(), {x, y});
    column = own_column, row = own_row;
  }
  return kept;
}

}  // namespace

void match(const Maps& m, const int32_t* rows, const double* guesses, const double* priors, int k, const double* ends,
           int b, double resolution, const MatchSettings& s, int threads, double* poses, double* information,
           double* score) {
  const Ends in_cells(ends, b, 1.0 / resolution);
  const Walls walls(in_cells, s.point_to_line);
  parallel_for(k, threads, [&](int i) {
    match_one(m, rows[i], guesses + 3 * i, priors + 9 * i, in_cells, walls, resolution, s, poses + 3 * i,
              information + 9 * i, score + i);
  });
}

void match_pose(const Maps& m, int row, const double* guess, const double* prior, const double* ends, int b,
                double thin_m, double resolution, const MatchSettings& s, double* pose, double* information,
                double* score, double* agreeing) {
  const int32_t rows[1] = {row};
  if (!(thin_m > 0)) {
    match(m, rows, guess, prior, 1, ends, b, resolution, s, 1, pose, information, score);
    *agreeing = *score;
    return;
  }
  const std::vector<double> kept = thin(ends, b, thin_m);
  match(m, rows, guess, prior, 1, kept.data(), static_cast<int>(kept.size() / 2), resolution, s, 1, pose, information,
        score);
  MatchSettings evaluating = s;
  evaluating.max_iterations = 0, evaluating.point_to_line = false;
  double same_pose[3], unused[9];
  match(m, rows, pose, prior, 1, ends, b, resolution, evaluating, 1, same_pose, unused, agreeing);
}

}  // namespace gridslam
