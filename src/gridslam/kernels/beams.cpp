// Which beams of a scan are used, where they end, and their ends in few bytes.
#include "beams.hpp"

#include <algorithm>
#include <cmath>

namespace gridslam {

size_t select_beams(const double* ranges, const uint8_t* status, size_t n, const double* directions,
                    const double* origin, double min_m, double max_m, int64_t* indices, double* ends) {
  constexpr uint8_t kHit = 0;
  size_t count = 0;
  for (size_t i = 0; i < n; ++i) {  // without a branch: which beams hit nothing cannot be foreseen
    const double range = ranges[i];
    indices[count] = static_cast<int64_t>(i);
    for (size_t k = 0; k < 2; ++k) ends[2 * count + k] = directions[2 * i + k] * range + origin[k];
    count += static_cast<size_t>(status[i] == kHit) & static_cast<size_t>(range >= min_m) &
             static_cast<size_t>(range < max_m);
  }
  return count;
}

double round_to_steps(const double* values, size_t n, int16_t most, int16_t* steps) {
  double farthest = 0.0;
  for (size_t i = 0; i < n; ++i) farthest = std::max(farthest, std::abs(values[i]));
  const double step = farthest / most, step_m = step > 0.0 ? step : 1.0;
  for (size_t i = 0; i < n; ++i) steps[i] = static_cast<int16_t>(std::nearbyint(values[i] / step_m));
  return step_m;
}

}  // namespace gridslam
