// Which beams of a scan are used, and where they end.
#pragma once
#include <cstddef>
#include <cstdint>

namespace gridslam {

// Returns their number k; of `indices` (n) and `ends` (n, 2) the first k are those of the beams that are used.
size_t select_beams(const double* ranges, const uint8_t* status, size_t n, const double* directions,
                    const double* origin, double min_m, double max_m, int64_t* indices, double* ends);

}  // namespace gridslam
