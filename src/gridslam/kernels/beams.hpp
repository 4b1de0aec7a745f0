// Which beams of a scan are used, where they end, and their ends in few bytes.
#pragma once
#include <cstddef>
#include <cstdint>

namespace gridslam {

// Returns their number k; of `indices` (n) and `ends` (n, 2) the first k are those of the beams that are used.
size_t select_beams(const double* ranges, const uint8_t* status, size_t n, const double* directions,
                    const double* origin, double min_m, double max_m, int64_t* indices, double* ends);

// Rounds n coordinates in m to whole steps, of which the farthest has `most`; returns the step in m, 1 where all are 0.
double round_to_steps(const double* values, size_t n, int16_t most, int16_t* steps);

}  // namespace gridslam
