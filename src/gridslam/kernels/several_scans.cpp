// Many scans, each with a pose of its own, in one call: drawn one after the other into one map, and weighed in between;
// or matched to one map. Each is what the kernels for a single scan do.

#include "several_scans.hpp"

#include "field.hpp"
#include "rays.hpp"

namespace gridslam {
namespace {

class Drawing {
 public:
  Drawing(const Maps& m, const FreeTiles& spare, const Evidence& e, const uint8_t* cone, int reach)
      : m_(m), spare_(spare), e_(e), cone_(cone), reach_(reach) {}

  // Whether the scan was drawn: not where it may take more tiles than there are.
  bool draw(const double* pose, const double* ends, int b, const double* origin, double resolution, int64_t room) {
    static constexpr int32_t kRow = 0;
    touched_.clear(), changed_.clear();
    tiles_on_rays(&kRow, pose, 1, ends, b, origin, resolution, 1, touched_);
    if (!fits(room)) return false;
    make_writable(touched_);
    update_log_odds(m_, &kRow, pose, 1, ends, b, origin, resolution, e_, 1, changed_);
    touched_.clear();
    tiles_near_cells(changed_.data(), static_cast<int>(changed_.size()), reach_, touched_);
    make_writable(touched_);
    pending_.insert(pending_.end(), changed_.begin(), changed_.end());
    return true;
  }

  // Lets the field follow: it depends on what is occupied in the end alone.
  void update_field() {
    const auto before = [](const Cell& a, const Cell& b) { return a.y != b.y ? a.y < b.y : a.x < b.x; };
    const auto same = [](const Cell& a, const Cell& b) { return a.y == b.y && a.x == b.x; };
    std::sort(pending_.begin(), pending_.end(), before);
    pending_.erase(std::unique(pending_.begin(), pending_.end(), same), pending_.end());
    std::erase_if(pending_, [&](Cell& cell) {
      const int64_t at =
          static_cast<int64_t>(m_.tile(m_.root(0), cell.y >> kTileBits, cell.x >> kTileBits)) * kTileCells +
          Maps::inside(cell.y, cell.x);
      cell.occupied = m_.log_odds[at] > e_.occupied_above;
      return (m_.field[at] == kOccupiedField) == (cell.occupied != 0);
    });
    gridslam::update_field(m_, pending_.data(), static_cast<int>(pending_.size()), cone_, reach_, 1);
    pending_.clear();
  }

  int64_t pages() const { return pages_; }
  int64_t tiles() const { return tiles_; }

 private:
  // Whether there are pages and tiles for all that the rays cross and for what may lie about their ends.
  bool fits(int64_t room) const {
    if (touched_.empty()) return true;
    int y_min = touched_.front()[1], y_max = y_min, x_min = touched_.front()[2], x_max = x_min;
    for (const auto& tile : touched_) {
      y_min = std::min(y_min, tile[1]), y_max = std::max(y_max, tile[1]);
      x_min = std::min(x_min, tile[2]), x_max = std::max(x_max, tile[2]);
    }
    TileSet around(y_min - 1, y_max + 1, x_min - 1, x_max + 1);
    for (const auto& tile : touched_)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) around.mark(tile[1] + dy, tile[2] + dx);
    int64_t tiles = 0;
    around.each([&](int y, int x) {
      const int32_t tile = m_.tile(m_.root(0), y, x);
      tiles += tile == 0 || spare_.tile_refs[tile] > 1;
    });
    const int64_t pages = static_cast<int64_t>(((y_max + 1) >> kPageBits) - ((y_min - 1) >> kPageBits) + 1) *
                          (((x_max + 1) >> kPageBits) - ((x_min - 1) >> kPageBits) + 1);
    return pages <= spare_.n_pages - pages_ && tiles <= spare_.n_tiles - tiles_ && tiles <= room - tiles_;
  }

  void make_writable(const TileList& tiles) {
    int64_t used[3];
    make_tiles_writable(m_, spare_.page_refs, spare_.tile_refs, spare_.pages, spare_.n_pages - pages_, spare_.tiles,
                        spare_.n_tiles - tiles_, reinterpret_cast<const int32_t*>(tiles.data()),
                        static_cast<int64_t>(tiles.size()), used);
    pages_ += used[0], tiles_ += used[1];
  }

  const Maps& m_;
  const FreeTiles& spare_;
  const Evidence& e_;
  const uint8_t* cone_;
  int reach_;
  int64_t pages_ = 0, tiles_ = 0;
  TileList touched_;
  std::vector<Cell> changed_, pending_;
};

// Cauchy weights of the ends of a scan in known cells, -1 in others.
void weigh(const Maps& m, const double* pose, const double* ends, int b, double resolution, double reach_cells,
           double scale_m, float* weights) {
  static constexpr int32_t kRow = 0;
  distances(m, &kRow, pose, 1, ends, b, resolution, reach_cells, 1, weights);
  const Pose at(pose);
  const float scale = static_cast<float>(scale_m);
  for (int j = 0; j < b; ++j) {
    const double* end = ends + 2 * j;
    const bool known = !m.is_unknown(m.root(0), cell_of(at.world_y(end), 1.0 / resolution),
                                     cell_of(at.world_x(end), 1.0 / resolution));
    const float away = weights[j] / scale;
    weights[j] = known ? 1.0f / (1.0f + away * away) : -1.0f;
  }
}

}  // namespace

Drawn draw_scans(const Maps& m, const FreeTiles& spare, const Scans& scans, int first, int last, double resolution,
                 const Evidence& e, const uint8_t* cone, int reach, int64_t room, const Weighing& weighing) {
  Drawing drawing(m, spare, e, cone, reach);
  int look = static_cast<int>(std::lower_bound(weighing.after, weighing.after + weighing.n, std::max(first, 1)) -
                              weighing.after);
  const auto weigh_after = [&](int drawn) {
    if (look < weighing.n && weighing.after[look] == drawn) drawing.update_field();
    for (; look < weighing.n && weighing.after[look] == drawn; ++look)
      weigh(m, scans.pose(look), scans.ends_of(look), scans.beams(look), resolution, weighing.reach_cells,
            weighing.scale_m, weighing.weights + scans.starts[look]);
  };
  int i = first;
  weigh_after(i);
  while (i < last && (scans.beams(i) == 0 || drawing.draw(scans.pose(i), scans.ends_of(i), scans.beams(i),
                                                          scans.origins + 2 * i, resolution, room)))
    weigh_after(++i);
  drawing.update_field();
  return {drawing.pages(), drawing.tiles(), i - first};
}

void match_scans(const Maps& m, const Scans& scans, const double* prior, double resolution, const MatchSettings& s,
                 int min_beams, int threads, double* poses, double* information, double* score) {
  static constexpr int32_t kRow = 0;
  parallel_for(scans.n, threads, [&](int i) {
    MatchSettings own = s;
    if (scans.beams(i) < min_beams) own.max_iterations = 0;
    match(m, &kRow, scans.pose(i), prior, 1, scans.ends_of(i), scans.beams(i), resolution, own, 1, poses + 3 * i,
          information + 9 * i, score + i);
  });
}

}  // namespace gridslam
