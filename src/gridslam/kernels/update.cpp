// The binary Bayes filter along the rays of a scan.

#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <utility>

#include "row_bits.hpp"
#include "update.hpp"

namespace gridslam {
namespace {

template <class Stored>
inline int value_or_zero(Stored v) {
  return v == kUnknown<Stored> ? 0 : v;
}

// Rows of a tile that one bit of what `free_tile` returns stands for.
template <class Stored>
constexpr int kRowsABit = kTile / std::numeric_limits<std::make_unsigned_t<Stored>>::digits;

// Frees the passed cells of a tile; returns a bit for each few rows in which some stop being occupied. All in as many
// bits as a cell has and without a branch inside a row, for many cells at once. Vectors have no product of bytes, so
// that a miss of one unit has a loop of its own.
template <bool kOfOneUnit, class Stored, class Count>
GRIDSLAM_INLINE unsigned free_cells(Stored* cells, const Count* passes, int stride, const Evidence& e) {
  using Whole = std::make_unsigned_t<Stored>;  // holds what the clamps and a miss are apart
  const Stored least = static_cast<Stored>(e.min), occupied = static_cast<Stored>(e.occupied_above);
  const Whole miss = static_cast<Whole>(-e.miss);
  constexpr int kGreatest = std::min<int64_t>(std::numeric_limits<Count>::max(), std::numeric_limits<int>::max());
  const Count most = static_cast<Count>(std::min((e.max - e.min) / miss + 1, kGreatest));  // passes that free any cell
  Whole left[kTile] = {};
  for (int y = 0; y < kTile; ++y, cells += kTile, passes += stride) {
    uint64_t words[kTile * sizeof(Count) / sizeof(uint64_t)], any = 0;
    std::memcpy(words, passes, sizeof(words));
    for (uint64_t w : words) any |= w;
    if (any == 0) continue;
    const Whole bit = static_cast<Whole>(1 << (y / kRowsABit<Stored>));
    for (int i = 0; i < kTile; ++i) {
      const Whole count = static_cast<Whole>(std::min(passes[i], most));
      const Stored before = cells[i] == kUnknown<Stored> ? Stored{0} : cells[i];
      const Whole above = static_cast<Whole>(std::max(before, least) - least);
      const Whole loss = kOfOneUnit ? count : static_cast<Whole>(count * miss);
      const Whole kept = above > loss ? static_cast<Whole>(above - loss) : Whole{0};
      const Stored after = static_cast<Stored>(kept + least);
      left[i] = static_cast<Whole>(left[i] | (-((before > occupied) & (after <= occupied)) & bit));
      cells[i] = count ? after : cells[i];
    }
  }
  unsigned some = 0;
  for (int i = 0; i < kTile; ++i) some |= left[i];
  return some;
}

#define GRIDSLAM_FREE_TILE(Stored, Count)                                                                           \
  GRIDSLAM_VERSIONS unsigned free_tile(Stored* cells, const Count* passes, int stride, const Evidence& e) {         \
    return e.miss == -1 ? free_cells<true>(cells, passes, stride, e) : free_cells<false>(cells, passes, stride, e); \
  }
GRIDSLAM_FREE_TILE(int8_t, uint8_t)
GRIDSLAM_FREE_TILE(int8_t, uint16_t)
GRIDSLAM_FREE_TILE(int8_t, uint32_t)
GRIDSLAM_FREE_TILE(int16_t, uint8_t)
GRIDSLAM_FREE_TILE(int16_t, uint16_t)
GRIDSLAM_FREE_TILE(int16_t, uint32_t)
#undef GRIDSLAM_FREE_TILE

// How often the rays of one scan pass each cell: a square of counters about the laser, of which only the tiles that the
// rays cross are used. Tiles beyond hold ends alone. It is kept from pose to pose: most lines of a scan lead from the
// laser's cell to the same cell as they did from the pose before, and only the others are counted again.
template <class Count>
class PassCounts {
 public:
  void see(const Fan& fan, const TileSet& tiles) {
    const size_t b = fan.xs.size();
    const int reach = std::min(kFreeCells, fan.reach());
    const bool fits = reach + kTile <= half_ && 4 * (reach + kTile) >= half_;
    others_.resize(b);
    size_t n = b;
    if (fits && before_.size() == b) {
      n = 0;
      for (size_t j = 0; j < b; ++j) {
        others_[n] = static_cast<int32_t>(j);
        n += before_[j].dx != fan.xs[j] - fan.x || before_[j].dy != fan.ys[j] - fan.y;
      }
    }
    if (2 * n > b) {
      clear();
      if (!fits) lay_out(reach);
      before_.resize(b);
      for (size_t j = 0; j < b; ++j) count(j, fan, 1);
    } else {
      for (size_t i = 0; i < n; ++i) {
        const auto j = static_cast<size_t>(others_[i]);
        add(before_[j].line(), -1);
        count(j, fan, 1);
      }
    }
    y_ = fan.y, x_ = fan.x, tiles_ = tiles;
  }

  // Where a cell of the map is counted; it must be covered.
  Count* at(int y, int x) { return memory_.get() + static_cast<int64_t>(y - y_ + half_) * width_ + (x - x_ + half_); }
  // Whether the tile's cells are counted that holds this cell.
  bool covers(int y, int x) const {
    const int first_y = (y & ~kTileMask) - y_, first_x = (x & ~kTileMask) - x_;
    return first_y >= -half_ && first_x >= -half_ && first_y + kTile <= half_ && first_x + kTile <= half_;
  }

  // Frees the cells that were passed; those that stop being occupied, while their field is still that of occupied
  // cells, go to `changed`.
  template <class Stored>
  void apply(const Maps& m, const int32_t* root, const Evidence& e, int row, std::vector<Cell>& changed) {
    Stored* const log_odds = m.log_odds.as<Stored>();
    int64_t tile = 0;
    int y = 0, x = 0;
    const auto pass = [&] {
      if (tile == 0) return;
      for (unsigned some = free_tile(log_odds + tile, at(y, x), width_, e); some != 0; some &= some - 1)
        for (int down = kRowsABit<Stored> * std::countr_zero(some), end = down + kRowsABit<Stored>; down < end;
             ++down) {
          const int64_t first = tile + down * kTile;
          for (uint32_t left = occupied_bits(m.field + first); left != 0; left &= left - 1) {
            const int across = std::countr_zero(left);
            if (log_odds[first + across] <= e.occupied_above) changed.push_back({row, y + down, x + across, 0});
          }
        }
    };
    tiles_.each([&](int ty, int tx) {  // a tile comes from memory while the one before it is freed
      if (!covers(ty * kTile, tx * kTile)) return;
      const int64_t next = m.tile(root, ty, tx) * static_cast<int64_t>(kTileCells);
      for (int i = 0; i < kTileCells; i += 64 / sizeof(Stored)) prefetch(log_odds + next + i);
      pass();
      tile = next, y = ty * kTile, x = tx * kTile;
    });
    pass();
  }

 private:
  struct Freed {
    void operator()(Count* memory) const { std::free(memory); }
  };
  struct Ray {
    int dx, dy;
    double slope;
    Line line() const { return Line(0, 0, dx, dy, slope); }
  };

  void count(size_t j, const Fan& fan, int by) {
    before_[j] = {fan.xs[j] - fan.x, fan.ys[j] - fan.y, fan.slopes[j]};
    add(before_[j].line(), by);
  }

  // Counts the cells that a line frees.
  void add(const Line& line, int by) {
    const int64_t row = width_, major = line.major_step * (line.along_x ? 1 : row),
                  minor = line.minor_step * (line.along_x ? row : 1);
    const uint64_t slope = line.slope;
    const int n = line.freed();
    const auto change = static_cast<Count>(by);
    uint64_t aside = line.start;
    Count* cell = memory_.get() + static_cast<int64_t>(half_) * width_ + half_;
    for (int i = 0; i < n; ++i, cell += major, aside += slope) {
      Count& passes = cell[static_cast<int64_t>(aside >> 32) * minor];
      passes = static_cast<Count>(passes + change);
    }
  }

  void clear() {
    tiles_.each([&](int ty, int tx) {
      if (!covers(ty * kTile, tx * kTile)) return;
      Count* first = at(ty * kTile, tx * kTile);
      for (int y = 0; y < kTile; ++y) std::fill_n(first + static_cast<int64_t>(y) * width_, kTile, Count{0});
    });
    tiles_.reset(0, -1, 0, -1);
    before_.clear();
  }

  void lay_out(int reach) {
    const int half = ((reach + kTile - 1) & ~kTileMask) + 2 * kTile;
    const size_t size = static_cast<size_t>(2 * half) * (2 * half);
    if (size_ < size || size_ > 2 * size) {
      half_ = 0;  // where memory runs out the next scan is laid out again
      size_ = 0;
      memory_.reset();
      memory_.reset(static_cast<Count*>(std::calloc(size, sizeof(Count))));
      if (memory_ == nullptr) throw std::bad_alloc();
      size_ = size;
    }
    half_ = half, width_ = 2 * half;
  }

  int half_ = 0, width_ = 0, y_ = 0, x_ = 0;
  TileSet tiles_;
  // 0 but for what the lines pass; pages that no line passes take no memory, as `calloc` does not write to them.
  std::unique_ptr<Count[], Freed> memory_;
  size_t size_ = 0;
  std::vector<Ray> before_;
  std::vector<int32_t> others_;
};

template <class Stored, class Count>
void add_counted(const Maps& m, int row, const Fan& fan, const TileSet& tiles, const Evidence& e,
                 std::vector<Cell>& changed) {
  thread_local PassCounts<Count> kept;
  thread_local std::vector<Count> kept_at_ends;
  PassCounts<Count>& passes = kept;
  std::vector<Count>& at_ends = kept_at_ends;
  const int32_t* root = m.root(row);
  const size_t b = fan.xs.size();
  passes.see(fan, tiles);
  at_ends.resize(b);
  for (size_t j = 0; j < b; ++j)  // no end of the scan is freed by it
    if (passes.covers(fan.ys[j], fan.xs[j])) at_ends[j] = std::exchange(*passes.at(fan.ys[j], fan.xs[j]), Count{0});
  passes.template apply<Stored>(m, root, e, row, changed);
  for (size_t j = b; j-- > 0;)
    if (passes.covers(fan.ys[j], fan.xs[j])) *passes.at(fan.ys[j], fan.xs[j]) = at_ends[j];
  for (size_t j = 0; j < b; ++j) {
    const int y = fan.ys[j], x = fan.xs[j];
    Stored& cell = m.log_odds.as<Stored>()[m.address(root, y, x)];
    const int before = value_or_zero(cell), after = std::min(before + e.hit, e.max);
    cell = static_cast<Stored>(after);
    if (before <= e.occupied_above && after > e.occupied_above) changed.push_back({row, y, x, 1});
  }
}

// That whose counts hold b passes.
template <class Stored>
auto counter(size_t b) {
  return b <= std::numeric_limits<uint8_t>::max()    ? add_counted<Stored, uint8_t>
         : b <= std::numeric_limits<uint16_t>::max() ? add_counted<Stored, uint16_t>
                                                     : add_counted<Stored, uint32_t>;
}

}  // namespace

void add_evidence(const Maps& m, int row, const Fan& fan, const TileSet& tiles, const Evidence& e,
                  std::vector<Cell>& changed) {
  const auto add = m.log_odds.in_bytes() ? counter<int8_t>(fan.xs.size()) : counter<int16_t>(fan.xs.size());
  add(m, row, fan, tiles, e, changed);
}

}  // namespace gridslam
