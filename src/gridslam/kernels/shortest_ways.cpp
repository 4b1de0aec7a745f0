// The least uncertain ways from a key scan to submaps, over a graph of submaps (Dijkstra).

#include "shortest_ways.hpp"

#include <queue>

#include "maps.hpp"

namespace gridslam {
namespace {

double wrap(double angle) {
  if (angle >= -kPi && angle < kPi) return angle;
  const double rest = std::fmod(angle, 2 * kPi);
  return rest >= kPi ? rest - 2 * kPi : rest < -kPi ? rest + 2 * kPi : rest;
}

struct Placed {
  double x, y, theta;
};

Placed at(const double* pose) { return {pose[0], pose[1], pose[2]}; }

Placed compose(const Placed& a, const Placed& b) {
  const double c = std::cos(a.theta), s = std::sin(a.theta);
  return {a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, wrap(a.theta + b.theta)};
}

Placed between(const Placed& a, const Placed& b) {
  const double c = std::cos(a.theta), s = std::sin(a.theta), dx = b.x - a.x, dy = b.y - a.y;
  return {c * dx + s * dy, c * dy - s * dx, wrap(b.theta - a.theta)};
}

struct Way {
  double cost;
  int order, submap;
  Moments moments;
  Placed end;
  int before;   // the submap from which a link leads here, -1 where none does
  Placed step;  // of that link
  bool operator<(const Way& o) const { return cost != o.cost ? cost > o.cost : order > o.order; }
};

}  // namespace

void shortest_ways(const SubmapGraph& graph, const WayStart& from, std::vector<int32_t>& found,
                   std::vector<Moments>& moments, std::vector<std::array<double, 3>>& ends) {
  std::vector<int> first_link(graph.n + 1, 0), link(graph.n_links);  // links by the submap that they leave, in order
  for (int i = 0; i < graph.n_links; ++i) ++first_link[graph.link_submaps[2 * i] + 1];
  for (int i = 0; i < graph.n; ++i) first_link[i + 1] += first_link[i];
  std::vector<int> next(first_link.begin(), first_link.end() - 1);
  for (int i = 0; i < graph.n_links; ++i) link[next[graph.link_submaps[2 * i]]++] = i;

  const double x = from.x, y = from.y, away = x * x + y * y;
  std::vector<double> least(graph.n, from.limit);
  std::vector<char> done(graph.n, 0);
  std::priority_queue<Way> queue;
  queue.push({0.0, 0, from.submap, from.moments, {from.pose.x, from.pose.y, from.pose.theta}, -1, {}});
  int pushed = 0;
  while (!queue.empty() && static_cast<int>(found.size()) < from.most && (from.last < 0 || !done[from.last])) {
    Way way = queue.top();
    queue.pop();
    if (done[way.submap]) continue;
    if (way.before >= 0)
      way.end = compose(at(graph.firsts + 3 * way.submap),
                        compose(way.step, between(at(graph.firsts + 3 * way.before), way.end)));
    done[way.submap] = 1;
    found.push_back(way.submap);
    moments.push_back(way.moments);
    ends.push_back({way.end.x, way.end.y, way.end.theta});
    const auto go = [&](int other, const double* own, int before, const Placed& step) {
      if (done[other]) return;
      Moments total;
      for (int k = 0; k < 9; ++k) total[k] = way.moments[k] + own[k];
      const auto& [xx, xy, yy, q, qx, qy, qxx, qxy, qyy] = total;
      const double across = q * away - 2 * (qx * x + qy * y) + qxx + qyy;
      const double position = way.moments[0] + own[0] + way.moments[2] + own[2];
      const double spread = std::max(way.cost, position + std::max(across, 0.0));
      if (!(spread < least[other])) return;
      least[other] = spread;
      queue.push({spread, ++pushed, other, total, way.end, before, step});
    };
    for (int i = first_link[way.submap]; i < first_link[way.submap + 1]; ++i) {
      const double* values = graph.links + 12 * static_cast<int64_t>(link[i]);
      go(graph.link_submaps[2 * link[i] + 1], values + 3, way.submap, at(values));
    }
    if (way.submap > 0) go(way.submap - 1, graph.steps + 9 * static_cast<int64_t>(way.submap - 1), -1, {});
    if (way.submap < graph.n_steps) go(way.submap + 1, graph.steps + 9 * static_cast<int64_t>(way.submap), -1, {});
  }
}

}  // namespace gridslam
