// Branch and bound over a pyramid of maxima (Hess et al. 2016, Algorithm 3), best first: the sum over the beams of a
// node's maxima bounds the score of every pose in it, so the first single pose that comes out of the queue is the best.

#include <bit>

#include "correlate.hpp"

namespace gridslam {

constexpr int kTopBits = std::countr_zero(static_cast<unsigned>(kTop));

GRIDSLAM_VERSIONS static void maxima(const uint8_t* GRIDSLAM_RESTRICT a, const uint8_t* GRIDSLAM_RESTRICT b, int n,
                                     uint8_t* GRIDSLAM_RESTRICT out) {
  for (int x = 0; x < n; ++x) out[x] = std::max(a[x], b[x]);
}

// Each of the first n values becomes the greatest of the kNode that begin with it; as many more can be read.
GRIDSLAM_VERSIONS static void widen(uint8_t* values, int n) {
  static_assert(kNode == 8);
  for (int x = 0; x < n; ++x) values[x] = std::max(values[x], values[x + 1]);
  for (int x = 0; x < n; ++x) values[x] = std::max(values[x], values[x + 2]);
  for (int x = 0; x < n; ++x) values[x] = std::max(values[x], values[x + 4]);
}

namespace {

// The greatest value of each square of kNode cells, and of kTop, for rows that are given from the last to the first:
// each time rows that came before double the squares' height. Past the last row and column all is 0.
class SquareMaxima {
 public:
  explicit SquareMaxima(int cols) : cols_(cols), rows_(kRows * static_cast<size_t>(cols + kTop)) {}

  void add(int y, const uint8_t* cells) {
    uint8_t* wide = row(0, y);
    std::copy_n(cells, cols_, wide);
    widen(wide, cols_);
    for (int doubled = 0; doubled < 3; ++doubled)
      maxima(row(doubled, y), row(doubled, y + (1 << doubled)), cols_, row(doubled + 1, y));
    maxima(nodes(y), row(3, y + kNode), cols_, high_.data());
    maxima(high_.data(), high_.data() + kNode, cols_, top_.data());
  }
  const uint8_t* nodes(int y) { return row(3, y); }
  const uint8_t* top() const { return top_.data(); }

 private:
  static constexpr int kRows = 2 + 4 + 8 + 16;  // of squares 1, 2, 4 and 8 cells high
  uint8_t* row(int doubled, int y) {
    const int kept = 2 << doubled;
    return rows_.data() + (kept - 2 + (y & (kept - 1))) * static_cast<size_t>(cols_ + kTop);
  }
  const int cols_;
  std::vector<uint8_t> rows_, high_ = std::vector<uint8_t>(cols_ + kTop), top_ = std::vector<uint8_t>(cols_);
};

// A row of a map's likelihoods.
void look_up_row(const uint8_t* field, const int32_t* ids, int tile_cols, int inside, const uint8_t* likelihood,
                 uint8_t* out) {
  for (int t = 0; t < tile_cols; ++t, out += kTile) {
    const uint8_t* cells = field + static_cast<int64_t>(ids[t]) * kTileCells + inside * kTile;
    for (int x = 0; x < kTile; ++x) out[x] = likelihood[cells[x]];
  }
}

}  // namespace

void max_pyramid(const uint8_t* field, const int32_t* ids, int tile_rows, int tile_cols, const uint8_t* likelihood,
                 const Pyramid<uint8_t>& out) {
  std::fill_n(out.top, kTop * kTop * out.phase_size(), uint8_t{0});
  SquareMaxima squares(out.cols);
  for (int y = out.rows - 1; y >= 0; --y) {
    uint8_t* cells = out.cells + out.index(y, 0);
    std::fill_n(cells, out.cols, uint8_t{0});
    const int in_map = y - kTop;
    if (in_map >= 0 && in_map < tile_rows * kTile)
      look_up_row(field, ids + static_cast<int64_t>(in_map >> kTileBits) * tile_cols, tile_cols, in_map & kTileMask,
                  likelihood, cells + kTop);
    squares.add(y, cells);
    std::copy_n(squares.nodes(y), out.cols, out.nodes + out.index(y, 0));
    uint8_t* first = out.phase(y, 0) + static_cast<int64_t>(y / kTop) * out.stride();
    for (int x = 0; x < out.cols; ++x) first[(x % kTop) * out.phase_size() + x / kTop] = squares.top()[x];
  }
}

namespace {

struct Node {
  int32_t bound, heading, y, x, side;  // poses [x, x + side) x [y, y + side) of one heading; side 1: a pose, its sum
  // Which of two comes later: of equal bounds the greater (heading, y, x), and so of equal poses the smallest comes
  // first.
  bool operator<(const Node& o) const {
    if (bound != o.bound) return bound < o.bound;
    if (heading != o.heading) return heading > o.heading;
    return y != o.y ? y > o.y : x > o.x;
  }
};

GRIDSLAM_VERSIONS void turn(const double* ends, int b, double c, double s, int border, int* x, int* y) {
  for (int j = 0; j < b; ++j) {
    x[j] = static_cast<int>(std::floor(c * ends[2 * j] - s * ends[2 * j + 1] + 0.5)) + border;
    y[j] = static_cast<int>(std::floor(s * ends[2 * j] + c * ends[2 * j + 1] + 0.5)) + border;
  }
}

// Beams' ends as seen from the centre of cell (0, 0) with one heading, as the cells of the frame that hold them.
struct Turned {
  std::vector<int> x, y;
  Turned(const double* ends, int b, double heading, int border) : x(b), y(b) {
    turn(ends, b, std::cos(heading), std::sin(heading), border, x.data(), y.data());
  }
};

// A row of the largest nodes: for each beam where its first one looks.
struct TopRow {
  std::vector<const uint8_t*> phase;
  std::vector<int> x, y;
  explicit TopRow(size_t b) : phase(b), x(b), y(b) {}
  void aim(const Pyramid<const uint8_t>& p, const Turned& ends, int x0, int y0) {
    for (size_t j = 0; j < x.size(); ++j) {
      const int u = x0 + ends.x[j], v = y0 + ends.y[j];
      phase[j] = p.phase(v, u), x[j] = u >> kTopBits, y[j] = v >> kTopBits;
    }
  }
};

template <int Nodes>
GRIDSLAM_INLINE void sum_strip(const Pyramid<const uint8_t>& p, const TopRow& row, int i, int j, uint16_t* bounds) {
  const int rows = p.top_rows(), cols = p.top_cols(), stride = p.stride();
  uint16_t sums[Nodes] = {};
  for (size_t b = 0; b < row.x.size(); ++b) {
    const int x = row.x[b] + i, y = row.y[b] + j;
    if (static_cast<unsigned>(y) >= static_cast<unsigned>(rows) || x <= -Nodes || x >= cols) continue;
    const uint8_t* value = row.phase[b] + static_cast<int64_t>(y) * stride + x;
    for (int k = 0; k < Nodes; ++k) sums[k] = static_cast<uint16_t>(sums[k] + value[k]);
  }
  std::copy_n(sums, Nodes, bounds);
}

// Bounds of nodes i0 .. i1 - 1 of row j; some more are written.
GRIDSLAM_VERSIONS void bound_row(const Pyramid<const uint8_t>& p, const TopRow& row, int i0, int i1, int j,
                                 uint16_t* bounds) {
  for (int i = i0; i < i1;) {
    if (i1 - i > 16)
      sum_strip<32>(p, row, i, j, bounds + i), i += 32;
    else
      sum_strip<16>(p, row, i, j, bounds + i), i += 16;
  }
}

// Bounds of the four nodes of a largest one, by y and x.
GRIDSLAM_VERSIONS void bound_nodes(const Pyramid<const uint8_t>& p, const Turned& ends, int y0, int x0, int bounds[4]) {
  const int64_t down = static_cast<int64_t>(kNode) * p.cols;
  int s0 = 0, s1 = 0, s2 = 0, s3 = 0;
  for (size_t b = 0; b < ends.x.size(); ++b) {
    const int y = std::clamp(y0 + ends.y[b], 0, p.rows - kTop), x = std::clamp(x0 + ends.x[b], 0, p.cols - kTop);
    const uint8_t* v = p.nodes + p.index(y, x);
    s0 += v[0], s1 += v[kNode], s2 += v[down], s3 += v[down + kNode];
  }
  bounds[0] = s0, bounds[1] = s1, bounds[2] = s2, bounds[3] = s3;
}

// Sums (kNode, kNode) of all poses of a node.
GRIDSLAM_VERSIONS void sum_poses(const Pyramid<const uint8_t>& p, const Turned& ends, const Node& node,
                                 uint16_t* sums) {
  uint16_t added[kNode * kNode] = {};
  for (size_t b = 0; b < ends.x.size(); ++b) {
    const int y0 = std::clamp(node.y + ends.y[b], 0, p.rows - kTop),
              x0 = std::clamp(node.x + ends.x[b], 0, p.cols - kTop);
    const uint8_t* cells = p.cells + p.index(y0, x0);
    for (int y = 0; y < kNode; ++y, cells += p.cols)
      for (int x = 0; x < kNode; ++x) added[y * kNode + x] = static_cast<uint16_t>(added[y * kNode + x] + cells[x]);
  }
  std::copy_n(added, kNode * kNode, sums);
}

// The gate's quadratic form along a row of nodes of one side, y and heading.
class Form {
 public:
  Form(const Gate& gate, const Node& node, double heading)
      : x0_(gate.centre[0]), xx_(gate.information[0]), half_(0.5 * (node.side - 1)), is_pose_(node.side == 1) {
    const double *c = gate.centre, *m = gate.information, y = node.y + half_ + 0.5 - c[1], t = heading - c[2];
    across_ = 2 * (m[1] * y + m[2] * t), aside_ = y * (m[4] * y + 2 * m[5] * t), turned_ = m[8] * t * t;
    const double reach = gate.distance + half_ * std::sqrt(m[0] + m[4] + 2 * std::abs(m[1]));
    most_ = is_pose_ ? gate.distance * gate.distance : reach * reach * (1 + 1e-9);
  }

  // Whether some pose of the node that begins at x may be within the gate; for a single pose, whether it is. The root
  // of the form is a norm: it changes by no more than the norm of the way from the node's centre to its farthest pose.
  bool may_pass(int node_x) const {
    const double x = node_x + half_ + 0.5 - x0_;
    return x * (xx_ * x + across_) + aside_ + turned_ <= most_;
  }

 private:
  double x0_, xx_, half_, across_, aside_, turned_, most_;
  bool is_pose_;
};

class Search {
 public:
  Search(const Pyramid<const uint8_t>& p, const double* ends, int b, const Lattice& lattice, const Gate& gate,
         const SearchLimits& limits)
      : p_(p), lattice_(lattice), gate_(gate), limits_(limits), least_(limits.min_sum) {
    turned_.reserve(lattice.turns);
    for (int a = 0; a < lattice.turns; ++a) turned_.emplace_back(ends, b, lattice.headings[a], kTop);
  }

  void run(std::vector<ScoredPose>& found) {
    bound_all();
    while (!queue_.empty() && static_cast<int>(found.size()) < limits_.count) {
      std::pop_heap(queue_.begin(), queue_.end());
      const Node node = queue_.back();
      queue_.pop_back();
      if (node.bound < least_) return;
      if (is_near_found_pose(node, found)) continue;
      if (node.side > 1) {
        push_poses(node);
      } else {
        found.push_back({node.bound, node.heading, node.y, node.x});
        const double least = std::ceil(limits_.min_runner_up_ratio * found.front().sum);
        least_ = std::max(least_, static_cast<int>(least));
      }
    }
  }

 private:
  // The largest nodes side by side, and at once those in what is left of them.
  void bound_all() {
    const int nx = (lattice_.x1 - lattice_.x0 + kTop - 1) >> kTopBits,
              ny = (lattice_.y1 - lattice_.y0 + kTop - 1) >> kTopBits;
    std::vector<uint16_t> bounds(nx + kStrip);
    for (int a = 0; a < lattice_.turns; ++a) {
      TopRow row(turned_[a].x.size());
      row.aim(p_, turned_[a], lattice_.x0, lattice_.y0);
      for (int j = 0; j < ny; ++j) {
        const auto node = [&](int i) { return Node{0, a, lattice_.y0 + j * kTop, lattice_.x0 + i * kTop, kTop}; };
        const Form form(gate_, node(0), lattice_.headings[a]);
        int first = 0, last = nx;
        while (first < last && !form.may_pass(node(first).x)) ++first;
        while (first < last && !form.may_pass(node(last - 1).x)) --last;
        if (first == last) continue;
        bound_row(p_, row, first, last, j, bounds.data());
        for (int i = first; i < last; ++i)
          if (bounds[i] >= least_) push_nodes(node(i));
      }
    }
    std::make_heap(queue_.begin(), queue_.end());
  }

  void push_nodes(const Node& largest) {
    int bounds[4];
    bound_nodes(p_, turned_[largest.heading], largest.y, largest.x, bounds);
    for (int k = 0; k < 4; ++k) {
      const Node node{bounds[k], largest.heading, largest.y + (k >> 1) * kNode, largest.x + (k & 1) * kNode, kNode};
      if (node.bound >= least_ && may_pass(node)) queue_.push_back(node);
    }
  }

  void push_poses(const Node& node) {
    uint16_t sums[kNode * kNode];
    sum_poses(p_, turned_[node.heading], node, sums);
    for (int y = 0; y < kNode; ++y)
      for (int x = 0; x < kNode; ++x) {
        const Node pose{sums[y * kNode + x], node.heading, node.y + y, node.x + x, 1};
        if (pose.bound < least_ || !may_pass(pose)) continue;
        queue_.push_back(pose);
        std::push_heap(queue_.begin(), queue_.end());
      }
  }

  bool may_pass(const Node& node) const {
    const bool begins_inside = node.x < lattice_.x1 && node.y < lattice_.y1;
    return begins_inside && Form(gate_, node, lattice_.headings[node.heading]).may_pass(node.x);
  }

  // Whether all poses of the node are at one of the places found.
  bool is_near_found_pose(const Node& node, const std::vector<ScoredPose>& found) const {
    const int more = node.side - 1;
    for (const ScoredPose& place : found) {
      const double turn = std::remainder(lattice_.headings[node.heading] - lattice_.headings[place.heading], 2 * kPi);
      const double x = std::max(std::abs(node.x - place.x), std::abs(node.x + more - place.x));
      const double y = std::max(std::abs(node.y - place.y), std::abs(node.y + more - place.y));
      const double squared = limits_.min_distance_cells * limits_.min_distance_cells;
      if (std::abs(turn) <= limits_.min_distance_rad && x * x + y * y <= squared) return true;
    }
    return false;
  }

  const Pyramid<const uint8_t>& p_;
  const Lattice& lattice_;
  const Gate& gate_;
  const SearchLimits& limits_;
  int least_;  // that a pose needs now
  std::vector<Turned> turned_;
  std::vector<Node> queue_;
};

}  // namespace

void correlate(const Pyramid<const uint8_t>& p, const double* ends, int b, const Lattice& lattice, const Gate& gate,
               const SearchLimits& limits, std::vector<ScoredPose>& found) {
  Search(p, ends, b, lattice, gate, limits).run(found);
}

}  // namespace gridslam
