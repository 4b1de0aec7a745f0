// Bits for the cells of a tile's row.
#pragma once
#include <bit>

#include "maps.hpp"

#if defined(GRIDSLAM_SSE2)
#include <emmintrin.h>
#endif

namespace gridslam {

// A bit for each of the 32 cells of a tile's row that equals `wanted` and is not 0.
inline uint32_t equal_bytes(const uint8_t* cells, const uint8_t* wanted) {
  uint32_t bits = 0;
#if defined(GRIDSLAM_SSE2)
  for (int i = 0; i < kTile; i += 16) {
    const __m128i a = _mm_loadu_si128(reinterpret_cast<const __m128i*>(cells + i)),
                  b = _mm_loadu_si128(reinterpret_cast<const __m128i*>(wanted + i));
    const __m128i found = _mm_andnot_si128(_mm_cmpeq_epi8(b, _mm_setzero_si128()), _mm_cmpeq_epi8(a, b));
    bits |= static_cast<uint32_t>(_mm_movemask_epi8(found)) << i;
  }
#else
  for (int i = 0; i < kTile; ++i) bits |= static_cast<uint32_t>(cells[i] == wanted[i] && wanted[i] != 0) << i;
#endif
  return bits;
}

// A bit for each occupied cell of a tile's row, read off the field.
inline uint32_t occupied_bits(const uint8_t* cells) {
  static constexpr std::array<uint8_t, kTile> kOccupied = [] {
    std::array<uint8_t, kTile> row{};
    row.fill(kOccupiedField);
    return row;
  }();
  return equal_bytes(cells, kOccupied.data());
}

}  // namespace gridslam
