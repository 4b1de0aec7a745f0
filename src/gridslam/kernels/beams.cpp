// Which beams of a scan are used, and where they end.
#include "beams.hpp"

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

}  // namespace gridslam
