#include "descriptors.hpp"

#include <bit>

namespace gridslam {

GRIDSLAM_VERSIONS void hamming_distances(const uint64_t* a, int64_t n, const uint64_t* b, int64_t m, int64_t words,
                                         int32_t* out) {
  for (int64_t i = 0; i < n; ++i) {
    for (int64_t j = 0; j < m; ++j) {
      int32_t bits = 0;
      for (int64_t w = 0; w < words; ++w) bits += std::popcount(a[i * words + w] ^ b[j * words + w]);
      out[i * m + j] = bits;
    }
  }
}

}  // namespace gridslam
