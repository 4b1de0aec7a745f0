// Landmark filters of many particles. All matrices are small: written out, a particle costs some hundred operations.

#include "landmarks.hpp"

#include "maps.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <type_traits>
#include <vector>

namespace gridslam {
namespace {

constexpr int kAhead = 8;  // particles

double wrapped(double angle) {
  constexpr double pi = std::numbers::pi;
  const double rest = angle >= -2 * pi && angle < 2 * pi ? angle : std::fmod(angle, 2 * pi);
  return rest - 2 * pi * (static_cast<double>(rest >= pi) - static_cast<double>(rest < -pi));
}

// Measurement of what lies at (dx, dy) from a robot with this heading; its rows by the landmark, and by the heading.
struct Measurement {
  double h[2], by_landmark[2][2], by_heading[2];
};

Measurement measure(LandmarkSensor sensor, double dx, double dy, double theta, double c, double s) {
  const double ahead = c * dx + s * dy, left = c * dy - s * dx;
  if (sensor == LandmarkSensor::relative_position) return {{ahead, left}, {{c, s}, {-s, c}}, {left, -ahead}};
  const double square = dx * dx + dy * dy, bearing = wrapped(std::atan2(dy, dx) - theta);
  const double across[2] = {-dy / square, dx / square};
  if (sensor == LandmarkSensor::depth_bearing)
    return {{ahead, bearing}, {{c, s}, {across[0], across[1]}}, {left, -1.0}};
  const double distance = std::sqrt(square);
  return {{distance, bearing}, {{dx / distance, dy / distance}, {across[0], across[1]}}, {0.0, -1.0}};
}

// J C J' (2, 2) of a Jacobian (2, N) and a covariance (N, N), added to `sum`.
template <int N>
void add_transformed(const double (&jacobian)[2][N], const double* covariance, double* sum) {
  for (int i = 0; i < 2; ++i) {
    double row[N] = {};
    for (int k = 0; k < N; ++k)
      for (int l = 0; l < N; ++l) row[l] += jacobian[i][k] * covariance[k * N + l];
    for (int j = 0; j < 2; ++j)
      for (int l = 0; l < N; ++l) sum[2 * i + j] += row[l] * jacobian[j][l];
  }
}

// Room for numbers whose count is part of the type where kCount > 0: then loops over them are unrolled.
template <int64_t kCount>
using Numbers = std::conditional_t<(kCount > 0), std::array<double, kCount>, std::vector<double>>;

template <int64_t kCount>
Numbers<kCount> room(int64_t count) {
  if constexpr (kCount > 0)
    return {};
  else
    return Numbers<kCount>(count);
}

// Calls work<D>() for Gaussians of `size` variables: D is the size of a landmark or of a pose, and 0 for any other.
template <class Work>
void with_size(int64_t size, const Work& work) {
  if (size == 2)
    work.template operator()<2>();
  else if (size == 3)
    work.template operator()<3>();
  else
    work.template operator()<0>();
}

}  // namespace

void predict_landmarks(LandmarkSensor sensor, const Landmarks& all, const int64_t* rows, const int64_t* columns,
                       int64_t r, const double* pose_covariances, const double* measured, const double* noise,
                       const Predictions& out) {
  const bool exact = all.calibration == nullptr;
  constexpr double none[2] = {};
  for (int64_t i = 0; i < r; ++i) {
    if (i + kAhead < r) {  // landmarks of two particles lie far apart
      const int64_t later = rows[i + kAhead] * all.columns + columns[i + kAhead];
      prefetch(all.positions + 2 * later), prefetch(all.covariances + 4 * later);
    }
    const double *pose = all.poses + 3 * rows[i], *calibration = exact ? none : all.calibration + 2 * rows[i];
    const int64_t landmark = rows[i] * all.columns + columns[i];
    const double mounted = calibration[0], scale = 1.0 + calibration[1];
    const bool turned = !(exact && sensor == LandmarkSensor::range_bearing);  // else the axes do not matter
    const double c = turned ? std::cos(pose[2]) : 1.0, s = turned ? std::sin(pose[2]) : 0.0;
    const double x = all.positions[2 * landmark] - (pose[0] + mounted * c);  // from the sensor
    const double y = all.positions[2 * landmark + 1] - (pose[1] + mounted * s);
    const Measurement seen = measure(sensor, scale * x, scale * y, pose[2], c, s);
    double by_landmark[2][2], by_pose[2][3], *sum = out.covariances + 4 * i;
    for (int k = 0; k < 2; ++k) {
      for (int l = 0; l < 2; ++l) by_landmark[k][l] = scale * seen.by_landmark[k][l], sum[2 * k + l] = noise[2 * k + l];
      by_pose[k][0] = -by_landmark[k][0], by_pose[k][1] = -by_landmark[k][1];
      by_pose[k][2] = seen.by_heading[k] - mounted * (by_landmark[k][1] * c - by_landmark[k][0] * s);
      if (!exact) {
        out.by_sensor[4 * i + 2 * k] = -(by_landmark[k][0] * c + by_landmark[k][1] * s);
        out.by_sensor[4 * i + 2 * k + 1] = seen.by_landmark[k][0] * x + seen.by_landmark[k][1] * y;
      }
      for (int l = 0; l < 2; ++l) out.by_landmark[4 * i + 2 * k + l] = by_landmark[k][l];
      for (int l = 0; l < 3; ++l) out.by_pose[6 * i + 3 * k + l] = by_pose[k][l];
    }
    add_transformed(by_landmark, all.covariances + 4 * landmark, sum);
    if (pose_covariances != nullptr) add_transformed(by_pose, pose_covariances + 9 * i, sum);
    const double turn = measured[1] - seen.h[1];
    out.residuals[2 * i] = measured[0] - seen.h[0];
    out.residuals[2 * i + 1] = sensor == LandmarkSensor::relative_position ? turn : wrapped(turn);
  }
}

void kalman_update(const Gaussians& all, const int64_t* rows, int64_t r, const double* jacobians,
                   const double* innovations, const double* residuals, double* shifts, double* gains) {
  with_size(all.size, [&]<int64_t kSize>() {
    const int64_t size = kSize > 0 ? kSize : all.size;
    auto shared = room<2 * kSize>(2 * size);  // P H' (size, 2)
    for (int64_t i = 0; i < r; ++i) {
      const double *H = jacobians + 2 * size * i, *S = innovations + 4 * i, *z = residuals + 2 * i;
      double *GRIDSLAM_RESTRICT P = all.covariances + size * size * rows[i], *mean = all.means + all.width * rows[i];
      double *GRIDSLAM_RESTRICT gain = gains + 2 * size * i, *GRIDSLAM_RESTRICT shift = shifts + size * i;
      const double determinant = S[0] * S[3] - S[1] * S[2];
      for (int64_t k = 0; k < size; ++k) {
        double a = 0, b = 0;
        for (int64_t l = 0; l < size; ++l) a += P[size * k + l] * H[l], b += P[size * k + l] * H[size + l];
        shared[2 * k] = a, shared[2 * k + 1] = b;
        gain[2 * k] = (a * S[3] - b * S[2]) / determinant;
        gain[2 * k + 1] = (b * S[0] - a * S[1]) / determinant;
        shift[k] = gain[2 * k] * z[0] + gain[2 * k + 1] * z[1];
      }
      for (int64_t k = 0; k < size; ++k)
        for (int64_t l = 0; l < size; ++l)
          P[size * k + l] -= gain[2 * k] * shared[2 * l] + gain[2 * k + 1] * shared[2 * l + 1];
      for (int64_t k = 0; k < all.width; ++k) mean[k] += shift[k];
    }
  });
}

// Cholesky's factor comes column by column, and each takes away what it explains; variances may be 0.
void draw_gaussians(const double* means, const double* covariances, const double* numbers, int64_t n, int64_t any_size,
                    double* drawn) {
  std::copy_n(means, n * any_size, drawn);
  with_size(any_size, [&]<int64_t kSize>() {
    const int64_t size = kSize > 0 ? kSize : any_size;
    auto left = room<kSize * kSize>(size * size);
    auto column = room<kSize>(size);
    for (int64_t i = 0; i < n; ++i) {
      std::copy_n(covariances + size * size * i, size * size, left.data());
      for (int64_t k = 0; k < size; ++k) {
        const double sigma = std::sqrt(std::max(left[size * k + k], 0.0)), number = numbers[size * i + k];
        for (int64_t l = 0; l < size; ++l) {
          column[l] = sigma > 0 ? left[size * k + l] / sigma : 0.0;  // no variance, no covariance
          drawn[size * i + l] += number * column[l];
        }
        for (int64_t a = 0; a < size; ++a)
          for (int64_t b = 0; b < size; ++b) left[size * a + b] -= column[a] * column[b];
      }
    }
  });
}

}  // namespace gridslam
