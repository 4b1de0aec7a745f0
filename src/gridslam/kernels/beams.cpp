// Which beams of a scan are used, and where they end.
#include "beams.hpp"

namespace gridslam {

void select_beams(const double* ranges, const uint8_t* status, int n, const double* directions, const double* origin,
                  double min_m, double max_m, std::vector<int64_t>& indices, std::vector<double>& ends) {
  constexpr uint8_t kHit = 0;
  indices.reserve(n), ends.reserve(2 * static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) {
    if (status[i] != kHit || !(ranges[i] >= min_m && ranges[i] < max_m)) continue;
    indices.push_back(i);
    for (int k = 0; k < 2; ++k) ends.push_back(directions[2 * i + k] * ranges[i] + origin[k]);
  }
}

}  // namespace gridslam
