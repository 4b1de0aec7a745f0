// The layout that every kernel shares: tiled maps behind a two-level table, as plain pointers.
// Level 1: roots[row][page row][page column] -> page (0: the empty page).
// Level 2: pages[page][16][16] -> tile (0: the empty tile, all unknown and far from everything).
// A tile is 32 x 32 cells; cell (0, 0) has its lower left corner at the world's origin, indices are signed.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numbers>
#include <vector>

#include "threads.hpp"

// One wheel for every x86-64: such a function is compiled thrice, and the loader takes the one that the CPU can run.
// All give identical results, as nothing is contracted or reassociated. Only GCC beside glibc does so: musl's loader
// cannot choose. The other extensions of compilers stand in this file, too, each behind its test.
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__) && !defined(GRIDSLAM_SANITIZE)
#define GRIDSLAM_VERSIONS __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#define GRIDSLAM_INLINE inline __attribute__((always_inline))  // else the default version is called from the fast one
#else
#define GRIDSLAM_VERSIONS
#define GRIDSLAM_INLINE inline
#endif

namespace gridslam {

inline void prefetch([[maybe_unused]] const void* p) {
#if defined(__GNUC__) || defined(__clang__)
  __builtin_prefetch(p, 1);
#endif
}

#if defined(__GNUC__) || defined(_MSC_VER)
#define GRIDSLAM_RESTRICT __restrict
#else
#define GRIDSLAM_RESTRICT
#endif

#if defined(__SSE2__) || defined(_M_X64)
#define GRIDSLAM_SSE2
#endif

#if defined(__x86_64__) && defined(__GNUC__) && !defined(GRIDSLAM_SANITIZE)
#define GRIDSLAM_AVX2 __attribute__((target("avx2")))
inline bool has_avx2() { return __builtin_cpu_supports("avx2"); }
#endif

constexpr double kPi = std::numbers::pi;
constexpr int kTileBits = 5;
constexpr int kTile = 1 << kTileBits;
constexpr int kTileMask = kTile - 1;
constexpr int kTileCells = kTile * kTile;
constexpr int kPageBits = 4;
constexpr int kPage = 1 << kPageBits;
constexpr int kPageMask = kPage - 1;
constexpr int kPageTiles = kPage * kPage;
constexpr uint8_t kOccupiedField = 255;
constexpr int kFarthest = 1 << 30;  // cells from the world's origin: nothing is mapped beyond, and indices fit 32 bits
constexpr int kFreeCells = 1664;    // that a beam frees, from the laser on: 83.2 m in cells of 5 cm

// Stored log-odds, in steps whose size the maps' owner knows: int8_t where all that a cell can hold fits in a byte,
// int16_t otherwise.
template <class Stored>
constexpr Stored kUnknown = std::numeric_limits<Stored>::min();

struct LogOdds {
  void* cells;
  int cell_bytes;  // 1 or 2

  bool in_bytes() const { return cell_bytes == 1; }
  template <class Stored>
  Stored* as() const {
    return static_cast<Stored*>(cells);
  }
  int at(int64_t cell) const { return in_bytes() ? as<int8_t>()[cell] : as<int16_t>()[cell]; }
  bool is_unknown(int64_t cell) const { return at(cell) == (in_bytes() ? kUnknown<int8_t> : kUnknown<int16_t>); }
  void copy_tile(int64_t from, int64_t to) const {
    const int64_t size = static_cast<int64_t>(kTileCells) * cell_bytes;
    std::memcpy(as<std::byte>() + to * size, as<std::byte>() + from * size, static_cast<size_t>(size));
  }
};

struct Maps {
  int32_t* roots;  // (rows, page_rows, page_cols)
  int page_rows, page_cols;
  int page_row0, page_col0;  // page coordinates of roots[.][0][0]
  int32_t* pages;            // (capacity, 16, 16)
  LogOdds log_odds;          // (capacity, 32, 32)
  uint8_t* field;            // (capacity, 32, 32)
  int64_t tiles;             // the capacity

  int32_t* root(int row) const { return roots + static_cast<int64_t>(row) * page_rows * page_cols; }

  // Tile that holds the cell, 0 outside the table.
  static inline int32_t tile_at(const Maps& m, const int32_t* root, int tile_y, int tile_x) {
    const int pr = (tile_y >> kPageBits) - m.page_row0;
    const int pc = (tile_x >> kPageBits) - m.page_col0;
    if (static_cast<unsigned>(pr) >= static_cast<unsigned>(m.page_rows) ||
        static_cast<unsigned>(pc) >= static_cast<unsigned>(m.page_cols))
      return 0;
    const int32_t page = root[pr * m.page_cols + pc];
    return m
        .pages[static_cast<int64_t>(page) * kPageTiles + ((tile_y & kPageMask) << kPageBits) + (tile_x & kPageMask)];
  }
  int32_t tile(const int32_t* root, int tile_y, int tile_x) const { return tile_at(*this, root, tile_y, tile_x); }

  static int inside(int cell_y, int cell_x) { return ((cell_y & kTileMask) << kTileBits) + (cell_x & kTileMask); }
  int64_t address(const int32_t* root, int cell_y, int cell_x) const {
    return static_cast<int64_t>(tile(root, cell_y >> kTileBits, cell_x >> kTileBits)) * kTileCells +
           inside(cell_y, cell_x);
  }
  bool is_unknown(const int32_t* root, int cell_y, int cell_x) const {
    return log_odds.is_unknown(address(root, cell_y, cell_x));
  }
  uint8_t field_at(const int32_t* root, int cell_y, int cell_x) const { return field[address(root, cell_y, cell_x)]; }
};

struct Pose {
  double x, y, c, s;
  Pose(const double* p) : x(p[0]), y(p[1]), c(std::cos(p[2])), s(std::sin(p[2])) {}
  double world_x(const double* q) const { return x + c * q[0] - s * q[1]; }
  double world_y(const double* q) const { return y + s * q[0] + c * q[1]; }
};

// A number of cells within `most`, as a value that an integer holds; what is no number lies at the lower end.
template <class Float>
GRIDSLAM_INLINE Float bounded(Float cells, Float most) {
  return std::min(std::max(-most, cells), most);  // in this order a NaN is left out
}

GRIDSLAM_INLINE int cell_of(double world, double inverse_resolution) {
  return static_cast<int>(bounded(std::floor(world * inverse_resolution), static_cast<double>(kFarthest)));
}

// Cells of the 8-connected line from (x0, y0) to (x1, y1): cell i of n = max(|dx|, |dy|) lies i cells along the major
// axis, and on the minor one at start + floor((2 i d + n) / (2 n)). That is kept as a 32.32 fixed point number, so that
// no cell waits for the one before it; its start is biased by more than the slope's rounding adds up to, and by far
// less than what separates two cells: ties go up for d >= 0 and down for d < 0.
struct Line {
  int x0, y0, n;
  bool along_x;
  int major_step, minor_step;
  uint64_t slope = 0, start = 1ull << 31;
  // 2^32 |minor| / |major|, of which Line takes the whole part: exact for lines shorter than 2^20 cells, as the
  // quotient is by 1 / n away from the next whole number, and is rounded by less.
  static GRIDSLAM_INLINE double slope_of(int dx, int dy) {
    const int across = std::abs(dx), up = std::abs(dy);
    return static_cast<double>(std::min(across, up)) * 0x1p32 / static_cast<double>(std::max(1, std::max(across, up)));
  }
  Line(int ax, int ay, int bx, int by, double quotient) : x0(ax), y0(ay) {
    const int dx = bx - ax, dy = by - ay;
    along_x = std::abs(dx) >= std::abs(dy);
    const int major = along_x ? dx : dy, minor = along_x ? dy : dx;
    n = std::abs(major);
    major_step = major >= 0 ? 1 : -1, minor_step = minor >= 0 ? 1 : -1;
    if (n == 0) return;
    slope = n < 1 << 20 ? static_cast<uint64_t>(static_cast<int64_t>(quotient))
                        : (static_cast<uint64_t>(std::abs(minor)) << 32) / static_cast<uint64_t>(n);
    start += minor >= 0 ? static_cast<uint64_t>(n) : ~0ull;
  }
  int freed() const { return std::min(n, kFreeCells); }  // cells 0 to freed() - 1 are passed
  int major(int i) const { return (along_x ? x0 : y0) + i * major_step; }
  int minor(int i) const {
    return (along_x ? y0 : x0) + static_cast<int>((start + static_cast<uint64_t>(i) * slope) >> 32) * minor_step;
  }
};

struct Cell {
  int32_t row, y, x, occupied;
};

using TileList = std::vector<std::array<int32_t, 3>>;

void tiles_on_rays(const int32_t* rows, const double* poses, int k, const double* ends, int b, const double* origin,
                   double resolution, int threads, TileList& out);
struct Arena;
int64_t make_tiles_writable(const Maps& m, Arena& arena, const int32_t* tiles_to_write, int64_t n);

struct Evidence {
  int hit, miss, min, max, occupied_above;
};
struct Scan {
  const double *ends, *origin;  // (b, 2), (2,)
  int b;
  double resolution;
};
constexpr int kOutside = -1, kNoRoom = -2;

struct MatchSettings {
  int max_iterations, min_ends;  // with fewer ends the guess is kept
  double cauchy_cells, max_step_cells, max_step_rad, stop_cells, stop_rad, reach_cells;
  double min_information;  // smallest eigenvalue of the position's information, per agreeing beam, that counts as
                           // determined
  bool point_to_line;      // ends on a straight wall count only across it
};
void match(const Maps& m, const int32_t* rows, const double* guesses, const double* priors, int k, const double* ends,
           int b, double resolution, const MatchSettings& s, int threads, double* poses, double* information,
           double* score);
void match_pose(const Maps& m, int row, const double* guess, const double* prior, const double* ends, int b,
                double thin_m, double resolution, const MatchSettings& s, double* pose, double* information,
                double* score, double* agreeing);
void distances(const Maps& m, const int32_t* rows, const double* poses, int k, const double* ends, int b,
               double resolution, double reach_cells, int threads, float* out);
void known_cells(const Maps& m, int row, const double* pose, const double* points, int b, double resolution, bool* out);
void cast_rays(const Maps& m, const int32_t* rows, const double* poses, int k, const double* origin,
               const double* directions, int b, double resolution, double max_m, int threads, float* out);
void sum_at_ends(const uint32_t* patches, int rows, int cols, const double* corner, double resolution,
                 const double* poses, int k, const double* ends, int b, int threads, double* out);

}  // namespace gridslam
