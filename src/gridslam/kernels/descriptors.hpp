// Binary descriptors of places.
#pragma once

#include <cstdint>

#include "maps.hpp"

namespace gridslam {

void hamming_distances(const uint64_t* a, int64_t n, const uint64_t* b, int64_t m, int64_t words, int32_t* out);

}  // namespace gridslam
