// Weighing many poses by one scan in one and the same map: the sum of a field over the ends of the beams.

#include "maps.hpp"

namespace gridslam {
namespace {

// Poses at once: enough that each of the three loops below is long, few enough that all they pass on stays in the
// cache.
constexpr int kPoses = 64;
constexpr int kFew = 8;      // those left over, as many at once
constexpr int kSingle = 32;  // beams that are added in single precision: their sum is exact to a thousandth of a step

// The ends of all beams, in cells.
struct Beams {
  std::vector<float> x, y;
  Beams(const double* ends, int b, double scale) : x(b), y(b) {
    for (int j = 0; j < b; ++j) {
      x[j] = static_cast<float>(bounded(ends[2 * j] * scale, static_cast<double>(kFarthest)));
      y[j] = static_cast<float>(bounded(ends[2 * j + 1] * scale, static_cast<double>(kFarthest)));
    }
  }
  int size() const { return static_cast<int>(x.size()); }
};

// Places in cells from the centre of the field's first cell, cosines and sines of the headings.
template <int N>
struct Poses {
  float x[N], y[N], c[N], s[N];
};

struct Patches {
  const uint32_t* values;  // each cell's own value and those of its neighbours, so that a look-up is one load
  int cols;
  float last_x, last_y;
};

// Sine and cosine of angles, in loops that run along them. What is left of an angle after whole quarters of a turn lies
// within pi / 4, where the series are exact to 1e-10.
template <int N>
GRIDSLAM_INLINE void sines(const double* angles, float* c, float* s) {
  constexpr double kLeast = kPi / 2 - 1.5707963267341256, kMany = 1e5;
  constexpr double kRound = 6755399441055744.0;  // 1.5 * 2^52: what is added to it is rounded to a whole number
  double left[N];
  int64_t quarter[N];
  for (int l = 0; l < N; ++l) {
    const double angle = bounded(angles[l], kMany);
    const double whole = (angle * (2 / kPi) + kRound) - kRound;
    left[l] = (angle - whole * 1.5707963267341256) - whole * kLeast;
    quarter[l] = static_cast<int>(whole) & 3;
  }
  for (int l = 0; l < N; ++l) {
    const double t = left[l], q = t * t;
    const double sine =
        t + t * q * (-1 / 6.0 + q * (1 / 120.0 + q * (-1 / 5040.0 + q * (1 / 362880.0 + q * (-1 / 39916800.0)))));
    const double cosine = 1 + q * (-0.5 + q * (1 / 24.0 + q * (-1 / 720.0 + q * (1 / 40320.0 + q * (-1 / 3628800.0)))));
    const bool odd = quarter[l] & 1;
    const double across = odd ? cosine : sine, along = odd ? sine : cosine;
    s[l] = static_cast<float>(quarter[l] & 2 ? -across : across);
    c[l] = static_cast<float>((quarter[l] + 1) & 2 ? -along : along);
  }
  for (int l = 0; l < N; ++l)
    if (!(std::abs(angles[l]) <= kMany))
      c[l] = static_cast<float>(std::cos(angles[l])), s[l] = static_cast<float>(std::sin(angles[l]));
}

// Sums (N,) of the field, 0 to 255, bilinearly interpolated at the ends of all beams. A pose's sum is added up beam by
// beam, so neither the number of poses at once nor the width of the machine's vectors changes it. Coordinates, loads
// and values have a loop each: the first and the last run as vectors, and no load waits for the one before it.
template <int N>
GRIDSLAM_INLINE void sums_at(const Patches& patches, const Poses<N>& poses, const Beams& ends, double* out) {
  int at[N];
  float a[N], b[N];
  uint32_t patch[N];
  for (int l = 0; l < N; ++l) out[l] = 0.0;
  for (int first = 0; first < ends.size(); first += kSingle) {
    const int last = std::min(first + kSingle, ends.size());
    float sums[N] = {};
    for (int j = first; j < last; ++j) {
      const float ex = ends.x[j], ey = ends.y[j];
      for (int l = 0; l < N; ++l) {
        const float u = std::min(std::max(0.0f, poses.x[l] + (poses.c[l] * ex - poses.s[l] * ey)), patches.last_x);
        const float v = std::min(std::max(0.0f, poses.y[l] + (poses.s[l] * ex + poses.c[l] * ey)), patches.last_y);
        const int iu = static_cast<int>(u), iv = static_cast<int>(v);  // a NaN has become 0
        a[l] = u - static_cast<float>(iu), b[l] = v - static_cast<float>(iv);
        at[l] = iv * patches.cols + iu;
      }
      for (int l = 0; l < N; ++l) patch[l] = patches.values[at[l]];
      for (int l = 0; l < N; ++l) {
        const int p = static_cast<int>(patch[l]);
        const float f00 = static_cast<float>(p & 255), f01 = static_cast<float>((p >> 8) & 255);
        const float f10 = static_cast<float>((p >> 16) & 255), f11 = static_cast<float>((p >> 24) & 255);
        const float low = f00 + a[l] * (f01 - f00), high = f10 + a[l] * (f11 - f10);
        sums[l] += low + b[l] * (high - low);
      }
    }
    for (int l = 0; l < N; ++l) out[l] += sums[l];
  }
}

template <int N>
GRIDSLAM_INLINE void weigh(const Patches& patches, const double* corner, double scale, const double* poses,
                           const Beams& ends, double* out) {
  double turns[N];
  Poses<N> some;
  for (int l = 0; l < N; ++l) {
    some.x[l] = static_cast<float>((poses[3 * l] - corner[0]) * scale - 0.5);
    some.y[l] = static_cast<float>((poses[3 * l + 1] - corner[1]) * scale - 0.5);
    turns[l] = poses[3 * l + 2];
  }
  sines<N>(turns, some.c, some.s);
  sums_at<N>(patches, some, ends, out);
}

GRIDSLAM_VERSIONS void weigh_many(const Patches& patches, const double* corner, double scale, const double* poses,
                                  const Beams& ends, double* out) {
  weigh<kPoses>(patches, corner, scale, poses, ends, out);
}

GRIDSLAM_VERSIONS void weigh_few(const Patches& patches, const double* corner, double scale, const double* poses, int n,
                                 const Beams& ends, double* out) {
  for (int i = 0; i < n; i += kFew) {
    double places[3 * kFew] = {}, sums[kFew];
    const int filled = std::min(kFew, n - i);
    std::copy_n(poses + 3 * i, 3 * filled, places);
    weigh<kFew>(patches, corner, scale, places, ends, sums);
    std::copy_n(sums, filled, out + i);
  }
}

}  // namespace

void sum_at_ends(const uint32_t* patches, int rows, int cols, const double* corner, double resolution,
                 const double* poses, int k, const double* ends, int b, int threads, double* out) {
  const double scale = 1.0 / resolution;
  const Beams in_cells(ends, b, scale);
  const Patches field{patches, cols, std::nextafter(static_cast<float>(cols), 0.0f),
                      std::nextafter(static_cast<float>(rows), 0.0f)};
  parallel_for((k + kPoses - 1) / kPoses, threads, [&](int block) {
    const int first = block * kPoses;
    if (k - first >= kPoses)
      weigh_many(field, corner, scale, poses + 3 * first, in_cells, out + first);
    else
      weigh_few(field, corner, scale, poses + 3 * first, k - first, in_cells, out + first);
  });
}

}  // namespace gridslam
