"""While the robot drives, old places are recognized where they are unlike all others, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from closure_worlds import Drive, deceptive
from gridslam.geometry.se2 import between, compose
from gridslam.matching.lines import measure_line_lengths
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import draw_submap
from gridslam.slam.loop_closure.walls import find_walls, leave_open
from gridslam.types import StoredScan
from support import hall
from support.oblong import map_room, scan_at

LAP = 95
"""Key scans of a lap in the hall."""


@pytest.fixture(scope="module")
def drives():
    return {seed: hall.key_scans(hall.drive(seed)) for seed in (1, 3)}


@pytest.mark.parametrize(("seed", "bias_rad_per_m"), [(1, 0.001), (1, 0.002), (3, -0.001), (3, 0.002)])
def test_the_way_is_recognized_when_it_is_driven_again(drives, seed, bias_rad_per_m):
    """After a lap the track is 0.25 to 2 m off; a submap of 20 m is bent by its own part of that."""
    seen = drives[seed]
    poses, closure_state = hall.tracked(seen.truth, bias_rad_per_m, 1.01), LoopClosureState()
    found = hall.remember(closure_state, seen, poses)
    constraints = [constraint for _, constraint in found]
    assert len(constraints) >= hall.RECOGNITION.min_matches
    recognized = [t for t in closure_state.graph.constraints if t.source is ConstraintSource.RECOGNIZED]
    assert [t.pair for t in recognized] == [t.pair for t in constraints]
    for key, constraint in found:
        assert constraint.to <= key
        assert constraint.to - constraint.from_ > LAP / 3
        assert constraint.determined
        assert np.linalg.eigvalsh(constraint.information)[0] > 0
    as_tracked = [
        constraint._replace(measurement=between(poses[constraint.from_], poses[constraint.to]))
        for constraint in constraints
    ]
    assert np.median(hall.errors(seen.truth, as_tracked)[:, 0]) > 0.2  # else it would not have been worth the search
    assert (hall.errors(seen.truth, constraints) < [0.3, 0.04]).all()


def test_a_revisit_is_recognized_within_a_submap_and_a_half(drives):
    """30 m after it began: one submap that lies in it, and the next ones, every 5 m."""
    seen, closure_state = drives[1], LoopClosureState()
    found = hall.remember(closure_state, seen, hall.tracked(seen.truth, 0.002, 1.01))
    way = closure_state.graph.driven_m()
    assert way[found[0][0]] - way[LAP] < 1.5 * hall.RECOGNITION.length_m


def test_where_the_way_back_is_certain_places_are_known_without_a_search(drives):
    """Tracked without an error, and the drift model knows."""
    seen, closure_state = drives[3], LoopClosureState()
    certain = DriftModel(
        sigma_m_per_sqrt_m=0.005, sigma_rad_per_sqrt_m=0.0003, sigma_rad_per_sqrt_rad=0.001, sigma_m_per_sqrt_rad=0.002
    )
    assert hall.remember(closure_state, seen, seen.truth, drift=certain) == []
    assert closure_state.search.candidates == []
    tracked = [t for t in closure_state.graph.constraints if t.source is ConstraintSource.TRACKED]
    assert len(tracked) > LAP / 2
    assert (hall.errors(seen.truth, hall.trusted(closure_state)) < [0.1, 0.02]).all()


def test_a_key_scan_that_is_taken_back_leaves_no_trace(drives):
    """As if it had not been: submaps that it completed are forgotten, and what was found in them."""
    seen = drives[1]
    poses = hall.tracked(seen.truth, 0.002, 1.01)
    for cut in (60, 120, 150):
        went_back, straight = LoopClosureState(), LoopClosureState()
        hall.remember(went_back, seen, poses, until=cut + 8)
        went_back.truncate(cut, cut)
        hall.remember(straight, seen, poses, until=cut)
        assert len(went_back.graph) == cut
        assert all(candidate.to < cut for candidate in went_back.search.candidates)
        ends = [hall.remember(state, seen, poses) for state in (went_back, straight)]
        assert {t.pair for _, t in ends[0]} >= {t.pair for k, t in ends[1] if k > cut + 30}


def driven(world: Drive) -> hall.Seen:
    return hall.key_scans(world.simulate())


@pytest.mark.parametrize(("kind", "seed"), [("equal_rooms", 0), ("symmetric", 2), ("bare_corridors", 0)])
def test_where_places_are_alike_none_is_recognized(kind, seed):
    """Rooms, wings and corridors like others before, hardly ever the same ones; the drift would allow for them."""
    seen, closure_state = driven(deceptive(kind, seed)), LoopClosureState()
    poses = hall.tracked(seen.truth, 0.0007, 1.01)
    hall.remember(closure_state, seen, poses, drift=DriftModel(sigma_m_per_sqrt_m=0.1, sigma_rad_per_sqrt_m=0.006))
    assert (hall.errors(seen.truth, hall.trusted(closure_state)) < [0.5, 0.09]).all()
    assert not any(constraint.source is ConstraintSource.RECOGNIZED for constraint in closure_state.graph.constraints)


def test_a_bare_corridor_driven_twice_has_no_place_along_it():
    """Constraints across it may be made, but none of where along it the robot is."""
    seen = driven(deceptive("bare_corridors", 0))
    once = next(k for k, pose in enumerate(seen.truth) if np.hypot(*pose[:2]) > 30)
    there = seen.truth[:once]
    assert abs(there[-1, 2]) < 0.2  # straight on
    beams, closure_state = list(seen.beams[:once]), LoopClosureState()
    again = hall.Seen(np.concatenate([there, there[::-1], there]), [*beams, *beams[::-1], *beams])
    hall.remember(
        closure_state,
        again,
        hall.tracked(again.truth, 0.0005, 1.01),
        drift=DriftModel(sigma_m_per_sqrt_m=0.1, sigma_rad_per_sqrt_m=0.006),
    )
    assert not any(constraint.source is ConstraintSource.RECOGNIZED for constraint in closure_state.graph.constraints)


COUNT = 65


@pytest.fixture(scope="module")
def closure_state():
    """65 key scans, tracked in a frame that drifts against that of the map."""
    seen, made = hall.key_scans(hall.drive(0)), LoopClosureState()
    hall.remember(made, seen, hall.tracked(seen.truth, 0.002), until=COUNT)
    return made


def contents(maps):
    return {name: array.tobytes() for name, array in maps.to_arrays().items()}


def test_what_is_kept_changes_nothing(closure_state):
    """Asked for in any order, before and after a correction."""
    graph = closure_state.graph
    once = [contents(draw_submap(submap, hall.MAPPER, closure_state.scans, graph)) for submap in range(6)]
    for k, submap in enumerate(np.random.default_rng(0).integers(0, 6, 20).tolist()):
        if k == 10:
            graph.correct(compose(np.array([5.0, -3.0, 1.0]), np.array(graph.poses)) * [1.01, 1.0, 1.0])
        assert contents(closure_state.submap(submap, hall.MAPPER)) == once[submap]
    assert closure_state.submap(submap, hall.MAPPER) is closure_state.submap(submap, hall.MAPPER)


ORIGIN = np.zeros(2)


def line(x0, y0, x1, y1):
    count = int(np.hypot(x1 - x0, y1 - y0) / 0.04)
    return np.column_stack([np.linspace(x0, x1, count), np.linspace(y0, y1, count)])


def test_each_beam_has_the_length_of_its_line():
    wall, box = line(-3, 2, 3, 2), line(-0.4, -1.5, 0.4, -1.5)
    ends = np.concatenate([wall, box])
    scan = StoredScan(ends[np.argsort(np.arctan2(ends[:, 1], ends[:, 0]))], ORIGIN)
    lengths = measure_line_lengths(scan.ends, ORIGIN)
    assert lengths[scan.ends[:, 1] > 0] == pytest.approx(6.0)
    assert lengths[scan.ends[:, 1] < 0] == pytest.approx(0.8)
    assert len(find_walls(scan)) == len(wall)


def test_what_stands_before_a_wall_is_no_part_of_its_line():
    wall, box = line(-3, 2, 3, 2), line(-0.4, 1.7, 0.4, 1.7)
    seen = wall[np.abs(wall[:, 0] / wall[:, 1]) > 0.4 / 1.7]  # the rest is hidden
    ends = np.concatenate([seen, box])
    scan = StoredScan(ends[np.argsort(np.arctan2(ends[:, 1], ends[:, 0]))], ORIGIN)
    lengths = measure_line_lengths(scan.ends, ORIGIN)
    assert (lengths[scan.ends[:, 1] > 1.9] > 2).mean() > 0.9
    assert lengths[scan.ends[:, 1] < 1.8].max() < 1


def test_walls_of_one_direction_leave_a_place_beside_open_and_those_of_a_room_do_not():
    maps, pose = map_room(), np.zeros(3)
    ends = scan_at(pose).ends
    assert not leave_open(maps, ends, pose)
    parallel = ends[(np.abs(ends[:, 1]) > 2) & (np.abs(ends[:, 0]) < 1.5)]
    assert leave_open(maps, parallel, pose)
