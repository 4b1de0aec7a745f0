// Branch and bound over a pyramid of maxima (Hess et al. 2016, Algorithm 3), best first: the sum over the beams of a
// node's maxima bounds the score of every pose in it, so the first single pose that comes out of the queue is the best.

#include <bit>
#include <cstring>
#include <memory>

#include "correlate.hpp"

namespace gridslam {

GRIDSLAM_VERSIONS static void maxima(const uint8_t* in, int rows, int cols, int step, uint8_t* out) {
  std::copy_n(in, static_cast<int64_t>(rows) * cols, out);  // at the far border there are zeros alone
  for (int y = 0; y + step < rows; ++y) {
    const uint8_t *a = in + static_cast<int64_t>(y) * cols, *b = a + static_cast<int64_t>(step) * cols;
    uint8_t* o = out + static_cast<int64_t>(y) * cols;
    for (int x = 0; x < cols - step; ++x) o[x] = std::max(std::max(a[x], a[x + step]), std::max(b[x], b[x + step]));
  }
}

// Cell x of a row goes to place x / 8 of row x % 8 of those that begin `apart` from each other, 64 cells at a time;
// returns how many places of each are filled.
static int split_by_eight(const uint8_t* in, int n, uint8_t* out, int64_t apart) {
  static_assert(std::endian::native == std::endian::little, "the order of bytes in a word is that of the cells");
  const auto exchange = [](uint64_t& a, uint64_t& b, int shift, uint64_t mask) {
    const uint64_t differ = ((a >> shift) ^ b) & mask;
    a ^= differ << shift, b ^= differ;
  };
  int done = 0;
  for (; (done + 8) * 8 <= n; done += 8) {
    uint64_t w[8];
    std::memcpy(w, in + done * 8, sizeof(w));
    for (int k = 0; k < 4; ++k) exchange(w[k], w[k + 4], 32, 0x00000000ffffffffu);
    for (int k : {0, 1, 4, 5}) exchange(w[k], w[k + 2], 16, 0x0000ffff0000ffffu);
    for (int k : {0, 2, 4, 6}) exchange(w[k], w[k + 1], 8, 0x00ff00ff00ff00ffu);
    for (int k = 0; k < 8; ++k) std::memcpy(out + k * apart + done, w + k, sizeof(uint64_t));
  }
  return done;
}

void max_pyramid(const uint8_t* likelihood, int rows, int cols, const Pyramid<uint8_t>& out) {
  const int64_t cells = static_cast<int64_t>(out.rows) * out.cols;
  const int side = out.side(), levels = out.levels, across = out.cols, stride = out.stride();
  std::fill_n(out.fine, cells, uint8_t{0});
  for (int y = 0; y < rows; ++y)
    std::copy_n(likelihood + static_cast<int64_t>(y) * cols, cols,
                out.fine + static_cast<int64_t>(y + side) * across + side);
  for (int h = 1; h < levels; ++h) maxima(out.level(h - 1), out.rows, across, 1 << (h - 1), out.level(h));
  const std::unique_ptr<uint8_t[]> coarsest(new uint8_t[cells]);
  maxima(out.level(levels - 1), out.rows, across, side / 2, coarsest.get());
  std::fill_n(out.top, static_cast<int64_t>(side) * side * (out.top_rows() + 1) * stride, uint8_t{0});
  for (int y = 0; y < out.rows; ++y) {
    const uint8_t* in = coarsest.get() + static_cast<int64_t>(y) * across;
    uint8_t* first = out.phase(y, 0) + static_cast<int64_t>(y >> levels) * stride;
    const int64_t apart = out.phase(y, 1) - out.phase(y, 0);
    const int done = side == 8 ? split_by_eight(in, across, first, apart) : 0;
    for (int x = done << levels; x < across; ++x) first[(x & (side - 1)) * apart + (x >> levels)] = in[x];
  }
}

namespace {

struct Node {
  int32_t bound, heading, y, x, level;  // poses [x, x + 2^level) x [y, y + 2^level) of one heading
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

// A row of nodes of the top level: for each beam where its first node looks.
struct TopRow {
  std::vector<const uint8_t*> phase;
  std::vector<int> x, y;
  explicit TopRow(size_t b) : phase(b), x(b), y(b) {}
  void aim(const Pyramid<const uint8_t>& p, const Turned& ends, int x0, int y0) {
    for (size_t j = 0; j < x.size(); ++j) {
      const int u = x0 + ends.x[j], v = y0 + ends.y[j];
      phase[j] = p.phase(v, u), x[j] = u >> p.levels, y[j] = v >> p.levels;
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
    const int left = i1 - i;
    if (left > 48)
      sum_strip<64>(p, row, i, j, bounds + i), i += 64;
    else if (left > 32)
      sum_strip<48>(p, row, i, j, bounds + i), i += 48;
    else if (left > 16)
      sum_strip<32>(p, row, i, j, bounds + i), i += 32;
    else
      sum_strip<16>(p, row, i, j, bounds + i), i += 16;
  }
}

// Bounds of the four children of a node, by y and x.
GRIDSLAM_VERSIONS void bound_children(const Pyramid<const uint8_t>& p, const Turned& ends, const Node& node,
                                      int bounds[4]) {
  const int step = 1 << (node.level - 1), side = p.side();
  const uint8_t* values = p.level(node.level - 1);
  const int64_t down = static_cast<int64_t>(step) * p.cols;
  int s0 = 0, s1 = 0, s2 = 0, s3 = 0;
  for (size_t j = 0; j < ends.x.size(); ++j) {
    const int x = std::clamp(node.x + ends.x[j], 0, p.cols - side),
              y = std::clamp(node.y + ends.y[j], 0, p.rows - side);
    const uint8_t* v = values + static_cast<int64_t>(y) * p.cols + x;
    s0 += v[0], s1 += v[step], s2 += v[down], s3 += v[down + step];
  }
  bounds[0] = s0, bounds[1] = s1, bounds[2] = s2, bounds[3] = s3;
}

// The gate's quadratic form along a row of nodes of one level, y and heading.
class Form {
 public:
  Form(const Gate& gate, const Node& node, double heading)
      : x0_(gate.centre[0]), xx_(gate.information[0]), half_(0.5 * ((1 << node.level) - 1)), is_pose_(node.level == 0) {
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
    for (int a = 0; a < lattice.turns; ++a) turned_.emplace_back(ends, b, lattice.headings[a], p.side());
  }

  void run(std::vector<ScoredPose>& found) {
    bound_all();
    while (!queue_.empty() && static_cast<int>(found.size()) < limits_.count) {
      std::pop_heap(queue_.begin(), queue_.end());
      const Node node = queue_.back();
      queue_.pop_back();
      if (node.bound < least_) return;
      if (is_near_found_pose(node, found)) continue;
      if (node.level > 0) {
        branch(node);
      } else {
        found.push_back({node.bound, node.heading, node.y, node.x});
        least_ = std::max<double>(least_, limits_.min_runner_up_ratio * found.front().sum);
      }
    }
  }

 private:
  void bound_all() {
    const int side = p_.side(), nx = (lattice_.x1 - lattice_.x0 + side - 1) >> p_.levels,
              ny = (lattice_.y1 - lattice_.y0 + side - 1) >> p_.levels;
    std::vector<uint16_t> bounds(nx + kStrip);
    for (int a = 0; a < lattice_.turns; ++a) {
      TopRow row(turned_[a].x.size());
      row.aim(p_, turned_[a], lattice_.x0, lattice_.y0);
      for (int j = 0; j < ny; ++j) {
        const auto node = [&](int i) { return Node{0, a, lattice_.y0 + j * side, lattice_.x0 + i * side, p_.levels}; };
        const Form form(gate_, node(0), lattice_.headings[a]);
        int first = 0, last = nx;
        while (first < last && !form.may_pass(node(first).x)) ++first;
        while (first < last && !form.may_pass(node(last - 1).x)) --last;
        if (first == last) continue;
        bound_row(p_, row, first, last, j, bounds.data());
        for (int i = first; i < last; ++i)
          if (bounds[i] >= least_) queue_.push_back(node(i)), queue_.back().bound = bounds[i];
      }
    }
    std::make_heap(queue_.begin(), queue_.end());
  }

  void branch(const Node& node) {
    int bounds[4];
    bound_children(p_, turned_[node.heading], node, bounds);
    const int step = 1 << (node.level - 1);
    for (int k = 0; k < 4; ++k) {
      const Node child{bounds[k], node.heading, node.y + (k >> 1) * step, node.x + (k & 1) * step, node.level - 1};
      if (child.bound < least_ || child.x >= lattice_.x1 || child.y >= lattice_.y1 || !may_pass(child)) continue;
      queue_.push_back(child);
      std::push_heap(queue_.begin(), queue_.end());
    }
  }

  bool may_pass(const Node& node) const { return Form(gate_, node, lattice_.headings[node.heading]).may_pass(node.x); }

  // Whether all poses of the node are at one of the places found.
  bool is_near_found_pose(const Node& node, const std::vector<ScoredPose>& found) const {
    const int more = (1 << node.level) - 1;
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
  double least_;
  std::vector<Turned> turned_;
  std::vector<Node> queue_;
};

}  // namespace

void correlate(const Pyramid<const uint8_t>& p, const double* ends, int b, const Lattice& lattice, const Gate& gate,
               const SearchLimits& limits, std::vector<ScoredPose>& found) {
  Search(p, ends, b, lattice, gate, limits).run(found);
}

}  // namespace gridslam
