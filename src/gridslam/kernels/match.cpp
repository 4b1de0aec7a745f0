// Gauss-Newton of a scan on the distance field, robustified by Cauchy weights; one independent problem for each guess.

#include "field.hpp"

namespace gridslam {
namespace {

struct Normal {  // of sum w d^2 in cells and radians: H = [h00 h01 h02; . h11 h12; . . h22]
  double h00 = 0, h01 = 0, h02 = 0, h11 = 0, h12 = 0, h22 = 0, g0 = 0, g1 = 0, g2 = 0, score = 0;
};

Normal linearize(FieldReader& field, double x, double y, double theta, const double* ends, int b, double scale, const MatchSettings& s) {
  const double c = std::cos(theta) * scale, sn = std::sin(theta) * scale;
  const double to_cells = s.reach_cells / 255.0, inverse_square = 1.0 / (s.cauchy_cells * s.cauchy_cells);
  Normal n;
  for (int j = 0; j < b; ++j) {
    const double rx = c * ends[2 * j] - sn * ends[2 * j + 1], ry = sn * ends[2 * j] + c * ends[2 * j + 1];
    const Sample f = field(x + rx, y + ry);
    const double d = s.reach_cells - to_cells * f.value;
    const double w = 1.0 / (1.0 + d * d * inverse_square);
    const double ju = -to_cells * f.du, jv = -to_cells * f.dv, jt = jv * rx - ju * ry;
    const double wu = w * ju, wv = w * jv, wt = w * jt;
    n.h00 += wu * ju, n.h01 += wu * jv, n.h02 += wu * jt;
    n.h11 += wv * jv, n.h12 += wv * jt, n.h22 += wt * jt;
    n.g0 += wu * d, n.g1 += wv * d, n.g2 += wt * d;
    n.score += w;
  }
  return n;
}

// Holds the guess along the direction in which the scan says too little about the position (a corridor's axis).
void hold_undetermined(const Normal& n, const MatchSettings& s, double h[6]) {
  const double t = n.h22 > 0 ? 1.0 / n.h22 : 0.0;
  const double a = n.h00 - n.h02 * n.h02 * t, b = n.h01 - n.h02 * n.h12 * t, c = n.h11 - n.h12 * n.h12 * t;
  const double mean = 0.5 * (a + c), half = std::sqrt(0.25 * (a - c) * (a - c) + b * b), least = s.min_information * n.score;
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

double wrapped(double a) { return a - 2 * M_PI * std::floor((a + M_PI) / (2 * M_PI)); }

void match_one(const Maps& m, int row, const double* guess, const double* prior, const double* ends, int b, double resolution,
               const MatchSettings& s, double* pose, double* information, double* score) {
  const double scale = 1.0 / resolution;
  const double p[6] = {prior[0] * resolution * resolution, prior[1] * resolution * resolution, prior[2] * resolution,
                       prior[4] * resolution * resolution, prior[5] * resolution, prior[8]};
  const double x0 = guess[0] * scale, y0 = guess[1] * scale;
  double x = x0, y = y0, theta = guess[2];
  FieldReader field(m, row);
  Normal n;
  bool current = false;
  for (int pass = 0; pass < s.max_passes; ++pass) {
    n = linearize(field, x, y, theta, ends, b, scale, s);
    current = true;
    double h[6] = {p[0], p[1], p[2], p[3], p[4], p[5]};
    hold_undetermined(n, s, h);
    const double ex = x - x0, ey = y - y0, et = theta - guess[2];
    const double g[3] = {n.g0 + h[0] * ex + h[1] * ey + h[2] * et, n.g1 + h[1] * ex + h[3] * ey + h[4] * et,
                         n.g2 + h[2] * ex + h[4] * ey + h[5] * et};
    h[0] += n.h00, h[1] += n.h01, h[2] += n.h02, h[3] += n.h11, h[4] += n.h12, h[5] += n.h22;
    double step[3];
    if (!solve(h, g, step)) break;
    const double length = std::hypot(step[0], step[1]), shorter = length > s.max_step_cells ? s.max_step_cells / length : 1.0;
    const double turn = std::clamp(step[2], -s.max_step_rad, s.max_step_rad);
    x -= shorter * step[0], y -= shorter * step[1], theta -= turn;
    current = false;
    if (length < s.stop_cells && std::abs(step[2]) < s.stop_rad) break;
  }
  if (!current) n = linearize(field, x, y, theta, ends, b, scale, s);
  pose[0] = x * resolution, pose[1] = y * resolution, pose[2] = wrapped(theta);
  *score = n.score;
  const double squared = scale * scale;
  information[0] = n.h00 * squared, information[4] = n.h11 * squared, information[8] = n.h22;
  information[1] = information[3] = n.h01 * squared;
  information[2] = information[6] = n.h02 * scale;
  information[5] = information[7] = n.h12 * scale;
}

}  // namespace

void match(const Maps& m, const int32_t* rows, const double* guesses, const double* priors, int k, const double* ends, int b,
           double resolution, const MatchSettings& s, int threads, double* poses, double* information, double* score) {
  parallel_for(k, threads, [&](int i) {
    match_one(m, rows[i], guesses + 3 * i, priors + 9 * i, ends, b, resolution, s, poses + 3 * i, information + 9 * i, score + i);
  });
}

}  // namespace gridslam
