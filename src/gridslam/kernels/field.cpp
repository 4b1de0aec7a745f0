// The field at the four cells about each end of a scan.
#include "field.hpp"

#include <bit>

#if defined(GRIDSLAM_AVX2)
#include <immintrin.h>
#endif

namespace gridslam {
namespace {

uint32_t corners_at(const Maps& m, const int32_t* root, int x, int y) {
  const auto at = [&](int cell_y, int cell_x) { return static_cast<uint32_t>(m.field_at(root, cell_y, cell_x)); };
  return at(y, x) | at(y, x + 1) << 8 | at(y + 1, x) << 16 | at(y + 1, x + 1) << 24;
}

using LookUp = void (*)(const Maps& m, const int32_t* root, const int32_t* x, const int32_t* y, int n, uint32_t* out);

void look_up(const Maps& m, const int32_t* root, const int32_t* x, const int32_t* y, int n, uint32_t* out) {
  for (int j = 0; j < n; ++j) {
    const int ix = x[j] & kTileMask, iy = y[j] & kTileMask;
    if (ix < kTileMask && iy < kTileMask) {
      const int64_t tile = m.tile(root, y[j] >> kTileBits, x[j] >> kTileBits);
      const uint8_t* p = m.field + tile * kTileCells + (iy << kTileBits) + ix;
      out[j] = static_cast<uint32_t>(p[0] | p[1] << 8 | p[kTile] << 16) | static_cast<uint32_t>(p[kTile + 1]) << 24;
    } else {
      out[j] = corners_at(m, root, x[j], y[j]);
    }
  }
}

#if defined(GRIDSLAM_AVX2)
constexpr int64_t kMostGathered = int64_t{1} << 21;  // tiles whose bytes 32 bits address

GRIDSLAM_AVX2 inline __m256i all(int value) { return _mm256_set1_epi32(value); }
GRIDSLAM_AVX2 inline __m256i load(const int32_t* p) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)); }

// Where in the field's bytes the four cells begin, for a multiple of kLanes ends; a bit for each end whose cells lie in
// more than one tile. Four bytes of a row are read, and none beyond its tile: the last three columns' are those before
// them.
GRIDSLAM_AVX2 void addresses(const Maps& m, const int32_t* root, const int32_t* x, const int32_t* y, int n,
                             uint32_t* out, uint8_t* apart) {
  const __m256i sign = all(std::numeric_limits<int>::min()), mask = all(kTileMask), page_mask = all(kPageMask);
  const __m256i rows = _mm256_xor_si256(all(m.page_rows), sign), cols = _mm256_xor_si256(all(m.page_cols), sign);
  for (int j = 0; j < n; j += kLanes) {
    const __m256i cx = load(x + j), cy = load(y + j);
    const __m256i tx = _mm256_srai_epi32(cx, kTileBits), ty = _mm256_srai_epi32(cy, kTileBits);
    const __m256i pc = _mm256_sub_epi32(_mm256_srai_epi32(tx, kPageBits), all(m.page_col0)),
                  pr = _mm256_sub_epi32(_mm256_srai_epi32(ty, kPageBits), all(m.page_row0));
    const __m256i inside = _mm256_and_si256(_mm256_cmpgt_epi32(rows, _mm256_xor_si256(pr, sign)),
                                            _mm256_cmpgt_epi32(cols, _mm256_xor_si256(pc, sign)));
    const __m256i at = _mm256_add_epi32(_mm256_mullo_epi32(pr, all(m.page_cols)), pc);
    const __m256i page = _mm256_mask_i32gather_epi32(_mm256_setzero_si256(), root, at, inside, 4);
    const __m256i entry =
        _mm256_or_si256(_mm256_slli_epi32(_mm256_and_si256(ty, page_mask), kPageBits), _mm256_and_si256(tx, page_mask));
    const __m256i tile =
        _mm256_i32gather_epi32(m.pages, _mm256_add_epi32(_mm256_slli_epi32(page, 2 * kPageBits), entry), 4);
    const __m256i ix = _mm256_and_si256(cx, mask), iy = _mm256_and_si256(cy, mask);
    const __m256i column = _mm256_min_epi32(ix, all(kTile - 4)), row = _mm256_min_epi32(iy, all(kTile - 2));
    const __m256i from = _mm256_add_epi32(_mm256_slli_epi32(tile, 2 * kTileBits),
                                          _mm256_add_epi32(_mm256_slli_epi32(row, kTileBits), column));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + j), from);
    const __m256i at_border = _mm256_or_si256(_mm256_cmpeq_epi32(ix, mask), _mm256_cmpeq_epi32(iy, mask));
    apart[j / kLanes] = static_cast<uint8_t>(_mm256_movemask_ps(_mm256_castsi256_ps(at_border)));
  }
}

// Reads what lies there, in place: nothing here waits for anything but the field: many reads are under way at once.
GRIDSLAM_AVX2 void read(const uint8_t* field, const int32_t* x, int n, uint32_t* out) {
  const int* bytes = reinterpret_cast<const int*>(field);
  const __m256i mask = all(kTileMask), last = all(kTile - 4), below = all(kTile);
  for (int j = 0; j < n; j += kLanes) {
    const __m256i from = load(reinterpret_cast<const int32_t*>(out + j)), ix = _mm256_and_si256(load(x + j), mask);
    const __m256i shift = _mm256_slli_epi32(_mm256_sub_epi32(ix, _mm256_min_epi32(ix, last)), 3);
    const __m256i low = _mm256_srlv_epi32(_mm256_i32gather_epi32(bytes, from, 1), shift),
                  high = _mm256_srlv_epi32(_mm256_i32gather_epi32(bytes, _mm256_add_epi32(from, below), 1), shift);
    const __m256i both = _mm256_blend_epi16(low, _mm256_slli_epi32(high, 16), 0xaa);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + j), both);
  }
}

void look_up_avx2(const Maps& m, const int32_t* root, const int32_t* x, const int32_t* y, int n, uint32_t* out) {
  constexpr int kAtOnce = 1024;
  std::array<uint8_t, kAtOnce / kLanes> apart;
  for (int first = 0; first < n; first += kAtOnce) {
    const int count = std::min(kAtOnce, n - first);
    addresses(m, root, x + first, y + first, count, out + first, apart.data());
    read(m.field, x + first, count, out + first);
    for (int i = 0; i < count / kLanes; ++i)
      for (unsigned left = apart[i]; left != 0; left &= left - 1) {
        const int j = first + i * kLanes + std::countr_zero(left);
        out[j] = corners_at(m, root, x[j], y[j]);
      }
  }
}
#endif

LookUp look_up_for([[maybe_unused]] const Maps& m) {
#if defined(GRIDSLAM_AVX2)
  static const bool fast = has_avx2();
  if (fast && m.tiles <= kMostGathered) return look_up_avx2;
#endif
  return look_up;
}

GRIDSLAM_VERSIONS void place(const CellPose& pose, const float* GRIDSLAM_RESTRICT ex, const float* GRIDSLAM_RESTRICT ey,
                             int n, float* GRIDSLAM_RESTRICT rx, float* GRIDSLAM_RESTRICT ry,
                             float* GRIDSLAM_RESTRICT a, float* GRIDSLAM_RESTRICT b, int32_t* GRIDSLAM_RESTRICT x,
                             int32_t* GRIDSLAM_RESTRICT y) {
  const CellPose at = pose;
  for (int j = 0; j < n; ++j) {
    const float east = at.c * ex[j] - at.s * ey[j], north = at.s * ex[j] + at.c * ey[j];
    const float u = at.fx + east, v = at.fy + north;
    const int iu = static_cast<int>(u), iv = static_cast<int>(v);
    const int fu = iu - (u < static_cast<float>(iu)), fv = iv - (v < static_cast<float>(iv));
    rx[j] = east, ry[j] = north;
    a[j] = u - static_cast<float>(fu), b[j] = v - static_cast<float>(fv);
    x[j] = at.x + fu, y[j] = at.y + fv;
  }
}

}  // namespace

void View::of(const Maps& m, const int32_t* root, const CellPose& pose, const Ends& ends) {
  const size_t n = static_cast<size_t>(ends.blocks) * kLanes;
  if (x.size() < n) {
    for (auto* part : {&rx, &ry, &a, &b}) part->resize(n);
    x.resize(n), y.resize(n), corners.resize(n);
  }
  place(pose, ends.x.data(), ends.y.data(), static_cast<int>(n), rx.data(), ry.data(), a.data(), b.data(), x.data(),
        y.data());
  look_up_for(m)(m, root, x.data(), y.data(), static_cast<int>(n), corners.data());
}

}  // namespace gridslam
