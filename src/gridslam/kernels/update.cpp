// The binary Bayes filter along the rays of a scan.

#include <cstring>

#include "row_bits.hpp"
#include "update.hpp"

namespace gridslam {
namespace {

inline int value_or_zero(int16_t v) { return v == kUnknown ? 0 : v; }

// Frees the passed cells of a tile; returns a bit for each two rows in which some stop being occupied. All in 16 bits
// and without a branch inside a row, for many cells at once.
template <class Count>
inline uint16_t free_tile(int16_t* cells, const Count* passes, int stride, const Evidence& e) {
  const int16_t least = static_cast<int16_t>(e.min), occupied = static_cast<int16_t>(e.occupied_above),
                miss = static_cast<int16_t>(-e.miss);
  constexpr int kGreatest = std::min<int64_t>(std::numeric_limits<Count>::max(), std::numeric_limits<int>::max());
  const Count most = static_cast<Count>(std::min((e.max - e.min) / miss + 1, kGreatest));  // passes that free any cell
  int16_t left[kTile] = {};
  for (int y = 0; y < kTile; ++y, cells += kTile, passes += stride) {
    uint64_t words[kTile * sizeof(Count) / sizeof(uint64_t)], any = 0;
    std::memcpy(words, passes, sizeof(words));
    for (uint64_t w : words) any |= w;
    if (any == 0) continue;
    const int16_t pair = static_cast<int16_t>(1 << (y >> 1));
    for (int i = 0; i < kTile; ++i) {
      const int16_t count = static_cast<int16_t>(std::min(passes[i], most));
      const int16_t before = cells[i] == kUnknown ? int16_t{0} : cells[i];
      const int16_t above = static_cast<int16_t>(before - least), loss = static_cast<int16_t>(count * miss);
      const int16_t after =
          static_cast<int16_t>((above > loss ? static_cast<int16_t>(above - loss) : int16_t{0}) + least);
      left[i] = static_cast<int16_t>(left[i] | (-((before > occupied) & (after <= occupied)) & pair));
      cells[i] = count ? after : cells[i];
    }
  }
  int16_t some = 0;
  for (int i = 0; i < kTile; ++i) some = static_cast<int16_t>(some | left[i]);
  return static_cast<uint16_t>(some);
}

GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint8_t* passes, int stride, const Evidence& e) {
  return free_tile<uint8_t>(cells, passes, stride, e);
}
GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint16_t* passes, int stride, const Evidence& e) {
  return free_tile<uint16_t>(cells, passes, stride, e);
}
GRIDSLAM_VERSIONS uint16_t free_tile(int16_t* cells, const uint32_t* passes, int stride, const Evidence& e) {
  return free_tile<uint32_t>(cells, passes, stride, e);
}

// How often the rays of one scan pass each cell: a rectangle of counters about the laser, of which only the tiles that
// they cross are used. Tiles beyond hold ends alone.
template <class Count>
class PassCounts {
 public:
  PassCounts(const TileSet& tiles, int y, int x, std::vector<Count>& memory)
      : y0_(std::max(tiles.y0, tile_of(y - kFreeCells)) * kTile),
        x0_(std::max(tiles.x0, tile_of(x - kFreeCells)) * kTile),
        height_((std::min(tiles.y0 + tiles.rows - 1, tile_of(y + kFreeCells)) + 1) * kTile - y0_),
        width_((std::min(tiles.x0 + tiles.cols - 1, tile_of(x + kFreeCells)) + 1) * kTile - x0_),
        tiles_(tiles) {
    const size_t size = static_cast<size_t>(height_) * width_;
    if (memory.size() < size) memory.resize(size);
    counts_ = memory.data();
    tiles.each([&](int ty, int tx) {
      if (!covers(ty * kTile, tx * kTile)) return;
      Count* first = at(ty * kTile, tx * kTile);
      for (int y = 0; y < kTile; ++y) std::fill_n(first + static_cast<size_t>(y) * width_, kTile, Count{0});
    });
  }
  Count* at(int y, int x) { return counts_ + static_cast<size_t>(y - y0_) * width_ + (x - x0_); }
  bool covers(int y, int x) const {
    return static_cast<unsigned>(y - y0_) < static_cast<unsigned>(height_) &&
           static_cast<unsigned>(x - x0_) < static_cast<unsigned>(width_);
  }

  // Counts the cells that a line frees.
  void add(const Line& line) {
    const int64_t row = width_, major = line.major_step * (line.along_x ? 1 : row),
                  minor = line.minor_step * (line.along_x ? row : 1);
    const uint64_t slope = line.slope;
    const int n = line.freed();
    uint64_t aside = line.start;
    Count* cell = at(line.y0, line.x0);
    for (int i = 0; i < n; ++i, cell += major, aside += slope) ++cell[static_cast<int64_t>(aside >> 32) * minor];
  }

  // Frees the cells that were passed; those that stop being occupied, while their field is still that of occupied
  // cells, go to `changed`.
  void apply(const Maps& m, const int32_t* root, const Evidence& e, int row, std::vector<Cell>& changed) {
    int64_t tile = 0;
    int y = 0, x = 0;
    const auto pass = [&] {
      if (tile == 0) return;
      for (unsigned pairs = free_tile(m.log_odds + tile, at(y, x), width_, e); pairs != 0; pairs &= pairs - 1)
        for (int down = 2 * std::countr_zero(pairs), last = down + 1; down <= last; ++down) {
          const int64_t first = tile + down * kTile;
          for (uint32_t left = occupied_bits(m.field + first); left != 0; left &= left - 1) {
            const int across = std::countr_zero(left);
            if (m.log_odds[first + across] <= e.occupied_above) changed.push_back({row, y + down, x + across, 0});
          }
        }
    };
    tiles_.each([&](int ty, int tx) {  // a tile comes from memory while the one before it is freed
      if (!covers(ty * kTile, tx * kTile)) return;
      const int64_t next = m.tile(root, ty, tx) * static_cast<int64_t>(kTileCells);
      for (int i = 0; i < kTileCells; i += 64 / sizeof(int16_t)) prefetch(m.log_odds + next + i);
      pass();
      tile = next, y = ty * kTile, x = tx * kTile;
    });
    pass();
  }

 private:
  static int tile_of(int cell) { return cell >> kTileBits; }

  int y0_, x0_, height_, width_;
  const TileSet& tiles_;
  Count* counts_;
};

template <class Count>
void add_counted(const Maps& m, int row, const Fan& fan, const TileSet& tiles, const Evidence& e,
                 std::vector<Cell>& changed) {
  thread_local std::vector<Count> memory;
  const int32_t* root = m.root(row);
  const size_t b = fan.xs.size();
  PassCounts<Count> passes(tiles, fan.y, fan.x, memory);
  for (size_t j = 0; j < b; ++j) passes.add(fan.line(j));
  for (size_t j = 0; j < b; ++j)
    if (passes.covers(fan.ys[j], fan.xs[j])) *passes.at(fan.ys[j], fan.xs[j]) = 0;  // no end of the scan is freed by it
  passes.apply(m, root, e, row, changed);
  for (size_t j = 0; j < b; ++j) {
    const int y = fan.ys[j], x = fan.xs[j];
    int16_t& cell = m.log_odds[static_cast<int64_t>(m.tile(root, y >> kTileBits, x >> kTileBits)) * kTileCells +
                               Maps::inside(y, x)];
    const int before = value_or_zero(cell), after = std::min(before + e.hit, e.max);
    cell = static_cast<int16_t>(after);
    if (before <= e.occupied_above && after > e.occupied_above) changed.push_back({row, y, x, 1});
  }
}

}  // namespace

void add_evidence(const Maps& m, int row, const Fan& fan, const TileSet& tiles, const Evidence& e,
                  std::vector<Cell>& changed) {
  const size_t b = fan.xs.size();
  const auto add = b <= std::numeric_limits<uint8_t>::max()    ? add_counted<uint8_t>
                   : b <= std::numeric_limits<uint16_t>::max() ? add_counted<uint16_t>
                                                               : add_counted<uint32_t>;
  add(m, row, fan, tiles, e, changed);
}

}  // namespace gridslam
