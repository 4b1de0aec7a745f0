// Many scans, each with a pose of its own, drawn into one map in one call, one after the other, and weighed in between.
// Each is what the kernels for a single scan do.

#include "several_scans.hpp"

#include <memory>

#include "field.hpp"
#include "update.hpp"

namespace gridslam {
namespace {

class Drawing {
 public:
  Drawing(const Maps& m, const FreeTiles& spare, const Evidence& e, const uint8_t* cone, int reach)
      : m_(m),
        spare_(spare),
        arena_{spare.page_refs, spare.tile_refs, spare.pages, spare.tiles, spare.n_pages, spare.n_tiles},
        e_(e),
        cone_(cone, reach) {}

  // Whether the scan was drawn: not where it may take more tiles than there are.
  bool draw(const double* pose, const double* ends, int b, const double* origin, double resolution, int64_t room) {
    fan_.see(Pose(pose), ends, b, origin, 1.0 / resolution);
    fan_.tiles(touched_);
    if (!fits(room)) return false;
    make_writable(touched_);
    changed_.clear();
    add_evidence(m_, 0, fan_, touched_, e_, changed_);
    if (changed_.empty()) return true;
    tiles_near_cells(changed_.data(), static_cast<int>(changed_.size()), cone_.reach, touched_);
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
      const int64_t at = m_.address(m_.root(0), cell.y, cell.x);
      cell.occupied = m_.log_odds.at(at) > e_.occupied_above;
      return (m_.field[at] == kOccupiedField) == (cell.occupied != 0);
    });
    follow(m_, m_.root(0), pending_.data(), static_cast<int>(pending_.size()), cone_);
    pending_.clear();
  }

  int64_t pages() const { return spare_.n_pages - arena_.n_free_pages; }
  int64_t tiles() const { return spare_.n_tiles - arena_.n_free_tiles; }

 private:
  // Whether there are pages and tiles for all that the rays cross and for what may lie about their ends.
  bool fits(int64_t room) {
    const int y_min = touched_.y0 - 1, y_max = touched_.y0 + touched_.rows, x_min = touched_.x0 - 1,
              x_max = touched_.x0 + touched_.cols;
    around_.reset(y_min, y_max, x_min, x_max);
    touched_.each([&](int y, int x) {
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) around_.mark(y + dy, x + dx);
    });
    int64_t tiles = 0;
    around_.each([&](int y, int x) {
      const int32_t tile = m_.tile(m_.root(0), y, x);
      tiles += tile == 0 || spare_.tile_refs[tile] > 1;
    });
    const int64_t pages = static_cast<int64_t>((y_max >> kPageBits) - (y_min >> kPageBits) + 1) *
                          ((x_max >> kPageBits) - (x_min >> kPageBits) + 1);
    return pages <= arena_.n_free_pages && tiles <= arena_.n_free_tiles && tiles <= room - this->tiles();
  }

  void make_writable(const TileSet& tiles) {
    tiles.each([&](int y, int x) { arena_.own(m_, 0, y, x); });
  }

  const Maps& m_;
  const FreeTiles& spare_;
  Arena arena_;
  const Evidence& e_;
  Cone cone_;
  Fan fan_;
  TileSet touched_, around_;
  std::vector<Cell> changed_, pending_;
};

// Cauchy weights of the ends of a scan in known cells, -1 in others.
void weigh(const Maps& m, const double* pose, const double* ends, int b, double resolution, double reach_cells,
           double scale_m, float* weights) {
  static constexpr int32_t kRow = 0;
  distances(m, &kRow, pose, 1, ends, b, resolution, reach_cells, 1, weights);
  const std::unique_ptr<bool[]> known(new bool[b]);
  known_cells(m, kRow, pose, ends, b, resolution, known.get());
  const float scale = static_cast<float>(scale_m);
  for (int j = 0; j < b; ++j) {
    const float away = weights[j] / scale;
    weights[j] = known[j] ? 1.0f / (1.0f + away * away) : -1.0f;
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

}  // namespace gridslam
