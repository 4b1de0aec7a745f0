// Gauss-Newton of a scan on the distance field, robustified by Cauchy weights; one independent problem for each guess.

#include "field.hpp"

namespace gridslam {
namespace {

struct Normal {  // of sum w d^2 in cells and radians: H = [h00 h01 h02; . h11 h12; . . h22]
  double h00 = 0, h01 = 0, h02 = 0, h11 = 0, h12 = 0, h22 = 0, g0 = 0, g1 = 0, g2 = 0, score = 0;
};

// clang-format off
enum Sum { kH00, kH01, kH02, kH11, kH12, kH22, kG0, kG1, kG2, kScore, kSums };
// clang-format on

// Normals of the straight walls on which ends lie, in the frame of the ends, (0, 0) where they lie on none, and then
// `along` is 1.
struct Walls {
  std::vector<float> x, y, along;
  Walls(const Ends& ends, bool point_to_line) : x(ends.x.size(), 0.0f), y(x), along(x.size(), 1.0f) {
    if (!point_to_line) return;
    constexpr int kFirst[3] = {-1, -2, 0};  // the end itself is the middle of three, or the last, or the first
    for (int i = 0; i < ends.n; ++i) {
      const float apart =
          std::max(i > 0 ? between(ends, i - 1, i) : 0.0f, i + 1 < ends.n ? between(ends, i, i + 1) : 0.0f);
      const int stride = std::max(1, static_cast<int>(std::ceil(std::min(kBase / apart, static_cast<float>(ends.n)))));
      for (const int first : kFirst) {
        const int a = i + first * stride, b = a + 2 * stride;
        if (a < 0 || b >= ends.n || !straight(ends, a, a + stride, b, i)) continue;
        along[i] = 0.0f;
        break;
      }
    }
  }

 private:
  static constexpr float kBase = 6.0f;  // cells between the three ends that must lie on a line
  static float between(const Ends& e, int i, int j) {
    const float dx = e.x[j] - e.x[i], dy = e.y[j] - e.y[i];
    return std::sqrt(dx * dx + dy * dy);
  }
  bool straight(const Ends& e, int a, int m, int b, int i) {
    constexpr float kAside = 0.6f;  // cells: more than a lidar scatters; walls that scatter more are not straight
    const float ux = e.x[m] - e.x[a], uy = e.y[m] - e.y[a], vx = e.x[b] - e.x[m], vy = e.y[b] - e.y[m];
    const float cx = ux + vx, cy = uy + vy, length = std::sqrt(cx * cx + cy * cy);
    if (ux * vx + uy * vy <= 0 || std::abs(ux * cy - uy * cx) > kAside * length) return false;
    x[i] = -cy / length, y[i] = cx / length;
    return true;
  }
};

GRIDSLAM_VERSIONS Normal linearize(const Maps& m, const int32_t* root, double x, double y, double theta,
                                   const Ends& ends, const Walls& walls, const MatchSettings& s) {
  const CellPose pose(x, y, theta);
  const float reach = static_cast<float>(s.reach_cells), to_cells = reach / 255.0f;
  const float inverse_square = static_cast<float>(1.0 / (s.cauchy_cells * s.cauchy_cells));
  constexpr float kBeyond = 3.0f;  // the gradient leans 55 degrees from the wall's normal
  float sums[kSums][kLanes] = {};  // lane by lane in a fixed order: identical results for any instruction set
  float ju[kLanes], jv[kLanes], beyond[kLanes];
  Block f;
  for (int block = 0; block < ends.blocks; ++block) {
    interpolate(m, root, pose, ends, block, f);
    for (int l = 0; l < kLanes; ++l) {
      const float gu = -to_cells * f.du[l], gv = -to_cells * f.dv[l];
      const int j = block * kLanes + l;
      const float nx = pose.c * walls.x[j] - pose.s * walls.y[j], ny = pose.s * walls.x[j] + pose.c * walls.y[j];
      const float across = gu * nx + gv * ny;
      beyond[l] = (nx * nx + ny * ny) * (gu * gu + gv * gv) - kBeyond * across * across;
      ju[l] = across * nx + walls.along[j] * gu, jv[l] = across * ny + walls.along[j] * gv;
    }
    for (int l = 0; l < kLanes; ++l)  // a wall goes on where it is not mapped yet: its mapped part's end, the nearest
                                      // there, is not informative
      if (beyond[l] > 0 && m.is_unknown(root, f.y[l], f.x[l])) ju[l] = jv[l] = 0.0f;
    const int filled = ends.n - block * kLanes;
    for (int l = 0; l < kLanes; ++l) {
      const float d = reach - to_cells * f.value[l];
      const float w = (l < filled ? 1.0f : 0.0f) / (1.0f + d * d * inverse_square);
      const float jt = jv[l] * f.rx[l] - ju[l] * f.ry[l];
      const float wu = w * ju[l], wv = w * jv[l], wt = w * jt;
      sums[kH00][l] += wu * ju[l], sums[kH01][l] += wu * jv[l], sums[kH02][l] += wu * jt;
      sums[kH11][l] += wv * jv[l], sums[kH12][l] += wv * jt, sums[kH22][l] += wt * jt;
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
  const double scale = 1.0 / resolution;
  // The prior weighs against residuals in metres, and both are divided by the squared resolution here.
  const double p[6] = {prior[0], prior[1], prior[2] * scale, prior[4], prior[5] * scale, prior[8] * scale * scale};
  const double x0 = guess[0] * scale, y0 = guess[1] * scale;
  double x = x0, y = y0, theta = guess[2];
  const int32_t* root = m.root(row);
  Normal n;
  bool current = false;
  for (int pass = 0; pass < s.max_iterations; ++pass) {
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

}  // namespace gridslam
