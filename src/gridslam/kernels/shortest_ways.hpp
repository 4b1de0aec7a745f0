// A graph of submaps: each is a step from the next one, and links join others.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gridslam {

using Moments = std::array<double, 9>;

struct SubmapGraph {
  const double* firsts;  // (n, 3) the first key scan of each submap as tracked
  int n;
  const double* steps;  // (n_steps, 9) moments of the way from each submap to the next
  int n_steps;
  const int32_t* link_submaps;  // (n_links, 2) from, to
  const double* links;          // (n_links, 12) the first key scan of `from` seen from that of `to`, and moments
  int n_links;
};

struct WayStart {
  int submap;
  Moments moments;
  struct {
    double x, y, theta;
  } pose;          // as tracked
  double x, y;     // in the map
  double limit;    // variance of the position at which the search ends
  int most, last;  // or after this many submaps, or with this one if it is not -1
};

void shortest_ways(const SubmapGraph& graph, const WayStart& from, std::vector<int32_t>& found,
                   std::vector<Moments>& moments, std::vector<std::array<double, 3>>& ends);

}  // namespace gridslam
