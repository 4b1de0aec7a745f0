// The door between Python and the kernels: arrays in, arrays out, the GIL released. Shapes, and rows of maps, are
// checked here, so that no memory but the arguments' is read; all else by the callers in Python, who can name it
// better.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>

#include <memory>
#include <numeric>
#include <vector>

#include "correlate.hpp"
#include "surfaces.hpp"
#include "update.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace gridslam {
namespace {

template <class T, int N>
using Array = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// An array of values that `new[]` has made: its owner from here on.
template <class T, int N>
nb::ndarray<nb::numpy, T> owning(T* data, std::array<size_t, N> shape) {
  nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return nb::ndarray<nb::numpy, T>(data, N, shape.data(), owner);
}

template <class T, int N>
nb::ndarray<nb::numpy, T> fresh(std::array<size_t, N> shape) {
  size_t size = 1;
  for (size_t s : shape) size *= s;
  return owning<T, N>(new T[size], shape);
}

template <class T>
nb::ndarray<nb::numpy, int32_t> as_rows(const T* data, size_t n, size_t width) {
  auto out = fresh<int32_t, 2>({n, width});
  std::copy_n(reinterpret_cast<const int32_t*>(data), n * width, out.data());
  return out;
}

template <class T, int... Lengths>
using Shaped = nb::ndarray<T, nb::shape<Lengths...>, nb::c_contig, nb::device::cpu>;  // -1: any length

using Roots = Array<int32_t, 3>;
using Pages = Shaped<int32_t, -1, kPage, kPage>;
using StoredLogOdds = nb::ndarray<nb::shape<-1, kTile, kTile>, nb::c_contig, nb::device::cpu>;  // int8 or int16
using Field = Shaped<uint8_t, -1, kTile, kTile>;
using Rows = Array<const int32_t, 1>;
using Matrix = Array<const double, 2>;
using Vector = Array<const double, 1>;
using Poses = Shaped<const double, -1, 3>;
using Points = Shaped<const double, -1, 2>;
using Priors = Shaped<const double, -1, 3, 3>;
using Triple = Shaped<const double, 3>;
using Pair = Shaped<const double, 2>;

void require(bool fits, const char* expected) {
  if (!fits) throw nb::index_error(expected);
}

// A row for each of some poses, of maps that are there.
void require_rows(const Rows& rows, size_t poses, size_t maps) {
  require(
      rows.shape(0) == poses && std::all_of(rows.data(), rows.data() + poses,
                                            [&](int32_t row) { return row >= 0 && static_cast<size_t>(row) < maps; }),
      "rows: expected one for each pose, of maps that are there");
}

Maps view(const Roots& roots, nb::tuple first, const Pages& pages, const StoredLogOdds& log_odds, const Field& field) {
  return Maps{roots.data(),
              static_cast<int>(roots.shape(1)),
              static_cast<int>(roots.shape(2)),
              nb::cast<int>(first[0]),
              nb::cast<int>(first[1]),
              pages.data(),
              {log_odds.data(), static_cast<int>(log_odds.itemsize())},
              field.data(),
              static_cast<int64_t>(field.shape(0))};
}

#define GRIDSLAM_MAPS Roots roots, nb::tuple first, Pages pages, StoredLogOdds log_odds, Field field
#define GRIDSLAM_MAPS_ARGS                                                                                \
  nb::arg("roots").noconvert(), "first"_a, nb::arg("pages").noconvert(), nb::arg("log_odds").noconvert(), \
      nb::arg("field").noconvert()

Arena arena_of(const Array<int32_t, 1>& page_refs, const Array<int32_t, 1>& tile_refs, const Rows& free_pages,
               const Rows& free_tiles) {
  return {page_refs.data(),
          tile_refs.data(),
          free_pages.data(),
          free_tiles.data(),
          static_cast<int64_t>(free_pages.shape(0)),
          static_cast<int64_t>(free_tiles.shape(0))};
}

auto py_tiles_on_rays(Rows rows, Poses poses, Points ends, Pair origin, double resolution, int threads) {
  require(rows.shape(0) == poses.shape(0), "rows: expected one for each pose");
  TileList out;
  {
    nb::gil_scoped_release release;
    tiles_on_rays(rows.data(), poses.data(), static_cast<int>(poses.shape(0)), ends.data(),
                  static_cast<int>(ends.shape(0)), origin.data(), resolution, threads, out);
  }
  return as_rows(out.data(), out.size(), 3);
}

auto py_make_tiles_writable(GRIDSLAM_MAPS, Array<int32_t, 1> page_refs, Array<int32_t, 1> tile_refs, Rows free_pages,
                            Rows free_tiles, Array<const int32_t, 2> tiles_to_write) {
  const Maps m = view(roots, first, pages, log_odds, field);
  Arena arena = arena_of(page_refs, tile_refs, free_pages, free_tiles);
  int64_t done;
  {
    nb::gil_scoped_release release;
    done = make_tiles_writable(m, arena, tiles_to_write.data(), static_cast<int64_t>(tiles_to_write.shape(0)));
  }
  return std::make_tuple(static_cast<int64_t>(free_pages.shape(0)) - arena.n_free_pages,
                         static_cast<int64_t>(free_tiles.shape(0)) - arena.n_free_tiles, done);
}

#define GRIDSLAM_UPDATE                                                                                         \
  Array<int32_t, 1> page_refs, Array<int32_t, 1> tile_refs, Rows free_pages, Rows free_tiles,                   \
      Shaped<const int32_t, -1, 4> pending, int64_t room, Rows rows, Poses poses, Points ends, Pair origin,     \
      double resolution, int hit, int miss, int min, int max, int occupied_above, Array<const uint8_t, 2> cone, \
      double margin_m, int threads
#define GRIDSLAM_UPDATE_ARGS                                                                                       \
  nb::arg("page_refs").noconvert(), nb::arg("tile_refs").noconvert(), "free_pages"_a, "free_tiles"_a, "pending"_a, \
      "room"_a, "rows"_a, "poses"_a, "ends"_a, "origin"_a, "resolution"_a, "hit"_a, "miss"_a, "min"_a, "max"_a,    \
      "occupied_above"_a, "cone"_a, "margin_m"_a, "threads"_a
#define GRIDSLAM_INSERTION                                                                                         \
  view(roots, first, pages, log_odds, field), arena_of(page_refs, tile_refs, free_pages, free_tiles), rows.data(), \
      poses.data(), static_cast<int>(poses.shape(0)),                                                              \
      Scan{ends.data(), origin.data(), static_cast<int>(ends.shape(0)), resolution},                               \
      Evidence{hit, miss, min, max, occupied_above}, cone.data(), static_cast<int>(cone.shape(0) / 2)

// What an update returns that had these free ids.
auto result_of(int status, const Insertion& insertion, const Rows& free_pages, const Rows& free_tiles) {
  const std::vector<int32_t> left = insertion.left();
  auto places = fresh<int32_t, 1>({left.size()});
  std::copy(left.begin(), left.end(), places.data());
  return std::make_tuple(status, static_cast<int64_t>(free_pages.shape(0)) - insertion.arena.n_free_pages,
                         static_cast<int64_t>(free_tiles.shape(0)) - insertion.arena.n_free_tiles, std::move(places),
                         as_rows(insertion.pending.data(), insertion.pending.size(), 4));
}

auto py_update(GRIDSLAM_MAPS, GRIDSLAM_UPDATE) {
  require_rows(rows, poses.shape(0), roots.shape(0));
  const auto* cells = reinterpret_cast<const Cell*>(pending.data());
  const std::vector<Cell> earlier(cells, cells + pending.shape(0));
  Insertion insertion(GRIDSLAM_INSERTION);
  int status;
  {
    nb::gil_scoped_release release;
    status = update(insertion, earlier, margin_m, room, threads);
  }
  return result_of(status, insertion, free_pages, free_tiles);
}

auto py_match(GRIDSLAM_MAPS, Rows rows, Poses guesses, Priors priors, Points ends, double resolution,
              int max_iterations, int min_ends, double cauchy_cells, double max_step_cells, double max_step_rad,
              double stop_cells, double stop_rad, double reach_cells, double min_information, bool point_to_line,
              int threads) {
  const Maps m = view(roots, first, pages, log_odds, field);
  const size_t k = guesses.shape(0);
  require_rows(rows, k, roots.shape(0));
  require(priors.shape(0) == k, "priors: expected one for each guess");
  auto poses = fresh<double, 2>({k, 3});
  auto information = fresh<double, 3>({k, 3, 3});
  auto score = fresh<double, 1>({k});
  {
    nb::gil_scoped_release release;
    match(m, rows.data(), guesses.data(), priors.data(), static_cast<int>(k), ends.data(),
          static_cast<int>(ends.shape(0)), resolution,
          {max_iterations, min_ends, cauchy_cells, max_step_cells, max_step_rad, stop_cells, stop_rad, reach_cells,
           min_information, point_to_line},
          threads, poses.data(), information.data(), score.data());
  }
  return std::make_tuple(poses, information, score);
}

// One pose, without an array for each of its numbers.
auto py_match_pose(GRIDSLAM_MAPS, int row, std::array<double, 3> guess, std::array<double, 6> prior, Points ends,
                   double thin_m, double resolution, int max_iterations, int min_ends, double cauchy_cells,
                   double max_step_cells, double max_step_rad, double stop_cells, double stop_rad, double reach_cells,
                   double min_information, bool point_to_line) {
  const Maps m = view(roots, first, pages, log_odds, field);
  require(row >= 0 && static_cast<size_t>(row) < roots.shape(0), "row: expected a map that is there");
  const auto& [xx, xy, xt, yy, yt, tt] = prior;
  const double whole[9] = {xx, xy, xt, xy, yy, yt, xt, yt, tt};
  double pose[3], h[9], score, agreeing;
  {
    nb::gil_scoped_release release;
    match_pose(m, row, guess.data(), whole, ends.data(), static_cast<int>(ends.shape(0)), thin_m, resolution,
               {max_iterations, min_ends, cauchy_cells, max_step_cells, max_step_rad, stop_cells, stop_rad, reach_cells,
                min_information, point_to_line},
               pose, h, &score, &agreeing);
  }
  return std::make_tuple(std::make_tuple(pose[0], pose[1], pose[2]),
                         std::make_tuple(h[0], h[1], h[2], h[4], h[5], h[8]), score, agreeing);
}

auto py_distances(GRIDSLAM_MAPS, Rows rows, Poses poses, Points ends, double resolution, double reach_cells,
                  int threads) {
  const Maps m = view(roots, first, pages, log_odds, field);
  require_rows(rows, poses.shape(0), roots.shape(0));
  auto out = fresh<float, 2>({poses.shape(0), ends.shape(0)});
  {
    nb::gil_scoped_release release;
    distances(m, rows.data(), poses.data(), static_cast<int>(poses.shape(0)), ends.data(),
              static_cast<int>(ends.shape(0)), resolution, reach_cells, threads, out.data());
  }
  return out;
}

auto py_known_cells(GRIDSLAM_MAPS, int row, Triple pose, Points points, double resolution) {
  const Maps m = view(roots, first, pages, log_odds, field);
  require(row >= 0 && static_cast<size_t>(row) < roots.shape(0), "row: expected a map that is there");
  auto out = fresh<bool, 1>({points.shape(0)});
  {
    nb::gil_scoped_release release;
    known_cells(m, row, pose.data(), points.data(), static_cast<int>(points.shape(0)), resolution, out.data());
  }
  return out;
}

auto py_cast_rays(GRIDSLAM_MAPS, Rows rows, Poses poses, Pair origin, Points directions, double resolution,
                  double max_m, int threads) {
  const Maps m = view(roots, first, pages, log_odds, field);
  require_rows(rows, poses.shape(0), roots.shape(0));
  auto out = fresh<float, 2>({poses.shape(0), directions.shape(0)});
  {
    nb::gil_scoped_release release;
    cast_rays(m, rows.data(), poses.data(), static_cast<int>(poses.shape(0)), origin.data(), directions.data(),
              static_cast<int>(directions.shape(0)), resolution, max_m, threads, out.data());
  }
  return out;
}

auto py_sum_at_ends(Array<const uint32_t, 2> patches, Pair corner, double resolution, Poses poses, Points ends,
                    int threads) {
  auto out = fresh<double, 1>({poses.shape(0)});
  {
    nb::gil_scoped_release release;
    sum_at_ends(patches.data(), static_cast<int>(patches.shape(0)), static_cast<int>(patches.shape(1)), corner.data(),
                resolution, poses.data(), static_cast<int>(poses.shape(0)), ends.data(),
                static_cast<int>(ends.shape(0)), threads, out.data());
  }
  return out;
}

using Starts = Array<const int64_t, 1>;

// Where each of some scans, and the last one, ends among `size` points.
void require_starts(const Starts& starts, size_t scans, size_t size) {
  const int64_t* const s = starts.data();
  require(starts.shape(0) == scans + 1 && s[0] >= 0 && std::is_sorted(s, s + scans + 1) &&
              static_cast<size_t>(s[scans]) <= size,
          "starts, origins: expected those of as many scans");
}

// Surfaces of scans, which belong together.
Surfaces view_surfaces(const Points& points, const Points& normals, const Vector& bearings, const Starts& starts,
                       const Points& origins) {
  const size_t size = points.shape(0);
  require(normals.shape(0) == size && bearings.shape(0) == size, "normals, bearings: expected one for each point");
  require_starts(starts, origins.shape(0), size);
  return {points.data(), normals.data(), bearings.data(), starts.data(), origins.data()};
}

auto py_match_surfaces(Points points, Points normals, Vector bearings, Starts starts, Points origins, Poses poses,
                       Shaped<const int64_t, -1, 2> pairs, double gate_m, double scale_m, bool both, bool by_incidence,
                       int threads) {
  const size_t scans = poses.shape(0);
  const Surfaces surfaces = view_surfaces(points, normals, bearings, starts, origins);
  require(origins.shape(0) == scans, "poses: expected one for each scan");
  require(std::all_of(pairs.data(), pairs.data() + pairs.size(),
                      [&](int64_t scan) { return scan >= 0 && static_cast<size_t>(scan) < scans; }),
          "pairs: expected scans that are there");
  auto out = fresh<double, 2>({pairs.shape(0), static_cast<size_t>(kSurfaceSums)});
  {
    nb::gil_scoped_release release;
    match_surfaces(surfaces, poses.data(), pairs.data(), static_cast<int64_t>(pairs.shape(0)), gate_m, scale_m, both,
                   by_incidence, threads, out.data());
  }
  return out;
}

auto py_fit_surfaces(Points ends, Starts starts, Points origins, double reach_m, int threads) {
  const size_t size = ends.shape(0), scans = origins.shape(0);
  require_starts(starts, scans, size);
  std::vector<double> points(2 * size), normals(2 * size), bearings(size);
  std::vector<int64_t> counts(scans);
  {
    nb::gil_scoped_release release;
    fit_surfaces(ends.data(), starts.data(), origins.data(), static_cast<int64_t>(scans), reach_m, threads,
                 points.data(), normals.data(), bearings.data(), counts.data());
  }
  auto out_starts = fresh<int64_t, 1>({scans + 1});
  int64_t* const at = out_starts.data();
  at[0] = 0;
  std::partial_sum(counts.begin(), counts.end(), at + 1);
  const auto found = static_cast<size_t>(at[scans]);
  auto out_points = fresh<double, 2>({found, size_t{2}});
  auto out_normals = fresh<double, 2>({found, size_t{2}});
  auto out_bearings = fresh<double, 1>({found});
  for (size_t scan = 0; scan < scans; ++scan) {
    const int64_t first = starts.data()[scan];
    std::copy_n(points.data() + 2 * first, 2 * counts[scan], out_points.data() + 2 * at[scan]);
    std::copy_n(normals.data() + 2 * first, 2 * counts[scan], out_normals.data() + 2 * at[scan]);
    std::copy_n(bearings.data() + first, counts[scan], out_bearings.data() + at[scan]);
  }
  return std::make_tuple(out_points, out_normals, out_bearings, out_starts);
}

// Short enough to keep the GIL: a scan takes some ten microseconds.
auto py_match_to_surfaces(Points points, Points normals, Vector bearings, Starts starts, Points origins, Poses poses,
                          Points ends, std::array<double, 3> guess, Triple prior, Vector gates_m, double scale_m,
                          double least_information) {
  const Surfaces fixed = view_surfaces(points, normals, bearings, starts, origins);
  require(origins.shape(0) == poses.shape(0), "poses: expected one for each scan");
  const std::array<int64_t, 2> own_starts{0, static_cast<int64_t>(ends.shape(0))};
  const Surfaces moved{ends.data(), nullptr, nullptr, own_starts.data(), nullptr};
  const SurfaceMatching how{prior.data(), gates_m.data(), static_cast<int64_t>(gates_m.shape(0)), scale_m,
                            least_information};
  const int64_t count =
      match_to_surfaces(fixed, poses.data(), static_cast<int64_t>(poses.shape(0)), moved, how, guess.data());
  return std::make_tuple(guess, count);
}

auto py_max_pyramid(Field field, Array<const int32_t, 2> ids, Array<const uint8_t, 1> likelihood) {
  const size_t rows = ids.shape(0) * kTile + 2 * kTop, cols = ids.shape(1) * kTile + 2 * kTop;
  auto cells = fresh<uint8_t, 2>({rows, cols}), nodes = fresh<uint8_t, 2>({rows, cols});
  Pyramid<uint8_t> p{cells.data(), nodes.data(), static_cast<int>(rows), static_cast<int>(cols), nullptr};
  auto top = fresh<uint8_t, 4>({kTop, kTop, static_cast<size_t>(p.top_rows()) + 1, static_cast<size_t>(p.stride())});
  p.top = top.data();
  {
    nb::gil_scoped_release release;
    max_pyramid(field.data(), ids.data(), static_cast<int>(ids.shape(0)), static_cast<int>(ids.shape(1)),
                likelihood.data(), p);
  }
  return std::make_tuple(cells, nodes, top);
}

auto py_correlate(Array<const uint8_t, 2> cells, Array<const uint8_t, 2> nodes, Array<const uint8_t, 4> top,
                  Matrix ends, Vector headings, std::array<int, 4> window, Vector centre, Matrix information,
                  double distance, int count, int min_sum, double min_runner_up_ratio, double min_distance_cells,
                  double min_distance_rad) {
  const Pyramid<const uint8_t> p{cells.data(), nodes.data(), static_cast<int>(cells.shape(0)),
                                 static_cast<int>(cells.shape(1)), top.data()};
  const Lattice lattice{window[0], window[1],       window[2],
                        window[3], headings.data(), static_cast<int>(headings.shape(0))};
  std::vector<ScoredPose> found;
  {
    nb::gil_scoped_release release;
    correlate(p, ends.data(), static_cast<int>(ends.shape(0)), lattice, {centre.data(), information.data(), distance},
              {count, min_sum, min_runner_up_ratio, min_distance_cells, min_distance_rad}, found);
  }
  return as_rows(found.data(), found.size(), 4);
}

}  // namespace
}  // namespace gridslam

NB_MODULE(_compiled, m) {
  using namespace gridslam;
  m.def("tiles_on_rays", &py_tiles_on_rays, "rows"_a, "poses"_a, "ends"_a, "origin"_a, "resolution"_a, "threads"_a);
  m.def("make_tiles_writable", &py_make_tiles_writable, GRIDSLAM_MAPS_ARGS, nb::arg("page_refs").noconvert(),
        nb::arg("tile_refs").noconvert(), "free_pages"_a, "free_tiles"_a, "tiles_to_write"_a);
  m.def("update", &py_update, GRIDSLAM_MAPS_ARGS, GRIDSLAM_UPDATE_ARGS);
  m.def("match", &py_match, GRIDSLAM_MAPS_ARGS, "rows"_a, "guesses"_a, "priors"_a, "ends"_a, "resolution"_a,
        "max_iterations"_a, "min_ends"_a, "cauchy_cells"_a, "max_step_cells"_a, "max_step_rad"_a, "stop_cells"_a,
        "stop_rad"_a, "reach_cells"_a, "min_information"_a, "point_to_line"_a, "threads"_a);
  m.def("match_pose", &py_match_pose, GRIDSLAM_MAPS_ARGS, "row"_a, "guess"_a, "prior"_a, "ends"_a, "thin_m"_a,
        "resolution"_a, "max_iterations"_a, "min_ends"_a, "cauchy_cells"_a, "max_step_cells"_a, "max_step_rad"_a,
        "stop_cells"_a, "stop_rad"_a, "reach_cells"_a, "min_information"_a, "point_to_line"_a);
  m.def("distances", &py_distances, GRIDSLAM_MAPS_ARGS, "rows"_a, "poses"_a, "ends"_a, "resolution"_a, "reach_cells"_a,
        "threads"_a);
  m.def("known_cells", &py_known_cells, GRIDSLAM_MAPS_ARGS, "row"_a, "pose"_a, "points"_a, "resolution"_a);
  m.def("cast_rays", &py_cast_rays, GRIDSLAM_MAPS_ARGS, "rows"_a, "poses"_a, "origin"_a, "directions"_a, "resolution"_a,
        "max_m"_a, "threads"_a);
  m.def("match_surfaces", &py_match_surfaces, "points"_a, "normals"_a, "bearings"_a, "starts"_a, "origins"_a, "poses"_a,
        "pairs"_a, "gate_m"_a, "scale_m"_a, "both"_a, "by_incidence"_a, "threads"_a);
  m.def("fit_surfaces", &py_fit_surfaces, "ends"_a, "starts"_a, "origins"_a, "reach_m"_a, "threads"_a);
  m.def("match_to_surfaces", &py_match_to_surfaces, "points"_a, "normals"_a, "bearings"_a, "starts"_a, "origins"_a,
        "poses"_a, "ends"_a, "guess"_a, "prior"_a, "gates_m"_a, "scale_m"_a, "least_information"_a);
  m.def("sum_at_ends", &py_sum_at_ends, "patches"_a, "corner"_a, "resolution"_a, "poses"_a, "ends"_a, "threads"_a);
  m.def("max_pyramid", &py_max_pyramid, "field"_a, "ids"_a, "likelihood"_a);
  m.def("correlate", &py_correlate, "cells"_a, "nodes"_a, "top"_a, "ends"_a, "headings"_a, "window"_a, "centre"_a,
        "information"_a, "distance"_a, "count"_a, "min_sum"_a, "min_runner_up_ratio"_a, "min_distance_cells"_a,
        "min_distance_rad"_a);
}
