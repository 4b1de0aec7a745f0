// Which beams of a scan are used, and where they end.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace gridslam {

void select_beams(const double* ranges, const uint8_t* status, int n, const double* directions, const double* origin,
                  double min_m, double max_m, std::vector<int64_t>& indices, std::vector<double>& ends);

}  // namespace gridslam
