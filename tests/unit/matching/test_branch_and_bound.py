"""The search in large windows: places found from afar, others told apart from them, and none where there is none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.geometry.angles import wrap
from gridslam.grid import cells_of
from gridslam.mapping import OccupancyGridMapping
from gridslam.matching import BranchAndBound, GaussNewton, Pyramid, thin_points
from gridslam.scan import Thinning
from gridslam.types import LaserScan, ScanGeometry

ROW = np.zeros(1, np.int32)
GEOMETRY = ScanGeometry(np.deg2rad(np.arange(0, 360, 0.5) - 179.75))
CELL = 0.05

# A room of 6 m x 4 m, no two of whose walls are alike
ROOM = np.array([
    [0, 0, 6, 0], [6, 0, 6, 2.5], [6, 2.5, 5, 2.5], [5, 2.5, 5, 4], [5, 4, 1.5, 4], [1.5, 4, 1.5, 3.2],
    [1.5, 3.2, 0, 3.2], [0, 3.2, 0, 0], [2, 1.2, 2.6, 1.2], [2.6, 1.2, 2.6, 1.6], [3.6, 0, 3.6, 0.7],
])  # fmt: skip


def off(pose, x, y, theta=0.0):
    """A pose (3,) moved by so much along each axis."""
    return pose + np.array([x, y, theta])


def ranges(walls, pose):
    """Distances (B,) to the nearest of walls (S, 4) = [x0, y0, x1, y1] along the beams; inf where there is none."""
    angles = GEOMETRY.bearings + pose[2]
    way = np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    start, along = walls[:, :2] - pose[:2], walls[:, 2:] - walls[:, :2]

    def cross(a, b):
        return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

    with np.errstate(divide="ignore", invalid="ignore"):
        beam, wall = cross(start, along) / cross(way, along), cross(start, way) / cross(way, along)
        met = np.where((beam > 0) & (wall >= 0) & (wall <= 1), beam, np.inf)
    return met.min(axis=1)


def beams_at(walls, pose, range_max_m=30.0):
    """All of them: which are taken of a dense scan hangs on the last digit of its ranges."""
    return LaserScan.from_ranges(0, ranges(walls, np.asarray(pose)), GEOMETRY).beams(0.05, range_max_m, Thinning(0.0))


def map_of(walls, poses, range_max_m=30.0):
    maps = OccupancyGridMapping().empty(1)
    for pose in poses:
        maps.update(ROW, np.array([pose]), beams_at(walls, pose, range_max_m))
    return maps


def assert_near(pose, truth, cells=2.0):
    """A scan's ends lie on the near side of walls a cell thick, the lattice half a cell apart: two cells at most."""
    assert math.hypot(*(pose[:2] - truth[:2])) < cells * CELL
    assert abs(wrap(pose[2] - truth[2])) < 0.03


@pytest.fixture(scope="module")
def room():
    return map_of(ROOM, [(1.0, 1.0, 0.3), (4.3, 1.5, 2.0), (3.0, 3.0, -1.0)])


@pytest.fixture(scope="module")
def pyramid(room):
    return Pyramid.of(room, 0)


TRUTH = np.array([3.2, 2.1, 0.9])


@pytest.mark.parametrize("seed", range(6))
def test_a_place_is_found_from_anywhere_in_the_window(pyramid, seed):
    """Up to 14 m and half a turn away; the slopes of its peak are no other place, nor is anything else in the room."""
    rng = np.random.default_rng(seed)
    truth = TRUTH + rng.uniform(-1, 1, 3) * [0.5, 0.5, 3.0]
    guess = truth + rng.uniform(-1, 1, 3) * [14.0, 14.0, 3.1]
    found = BranchAndBound(window_rad=math.pi, min_runner_up_ratio=0.7).search(
        pyramid, guess, None, beams_at(ROOM, truth).ends
    )
    assert_near(found.pose, truth)
    assert found.score > 0.8
    assert found.runner_up_pose is None
    assert found.runner_up_score == 0
    assert -math.pi <= found.pose[2] < math.pi


def test_the_share_is_what_the_matcher_says_of_the_same_pose(room, pyramid):
    """A cell's centre is at most 0.71 cells from what is in it; a weight's slope is 3 sqrt(3) / 8 / c = 0.325 a cell.

    The mean over the points moves by less than their product; of the matcher's floor, 1 / (1 + 10.5^2 / 4), the
    search knows nothing.
    """
    beams = beams_at(ROOM, TRUTH)
    found = BranchAndBound().search(pyramid, TRUTH, None, beams.ends)
    even = thin_points(beams.ends, BranchAndBound().max_points, CELL)
    few = replace(beams, indices=np.arange(len(even)), ends=even)
    match = GaussNewton(max_iterations=0)(room, ROW, found.pose[None], np.zeros((1, 3, 3)), few)
    assert found.score == pytest.approx(match.score[0] / len(even), abs=0.71 * 0.325)
    refined = GaussNewton()(room, ROW, found.pose[None], np.zeros((1, 3, 3)), beams)
    assert refined.score[0] / len(beams) > found.score
    assert_near(refined.poses[0], TRUTH, 1.0)


def test_a_rectangle_looks_the_same_after_half_a_turn():
    walls = np.array([[-3, -2, 3, -2], [3, -2, 3, 2], [3, 2, -3, 2], [-3, 2, -3, -2]], float)
    pyramid = Pyramid.of(map_of(walls, [(0.4, -0.3, 0.0), (-1.0, 0.5, 1.0)]), 0)
    pose = np.array([1.2, 0.7, 0.4])
    ends = beams_at(walls, pose).ends
    found = BranchAndBound(window_rad=math.pi).search(pyramid, np.zeros(3), None, ends)
    places = found.pose, found.runner_up_pose
    here = int(math.hypot(*(found.runner_up_pose - pose)[:2]) < 0.5)
    assert_near(places[here], pose)
    assert_near(places[1 - here], [-1.2, -0.7, 0.4 - math.pi])
    assert found.score >= found.runner_up_score > 0.95 * found.score
    within = BranchAndBound(window_rad=0.6).search(pyramid, off(pose, 0.5, 0.5, 0.1), None, ends)
    assert_near(within.pose, pose)
    assert within.runner_up_score < 0.8 * within.score


def test_of_equal_rooms_each_is_told_unless_the_covariance_rules_it_out():
    beside = ROOM + np.array([9, 1, 9, 1])
    walls = np.concatenate([ROOM, beside])
    seen = np.array([(3.2, 2.1, 0.9), (1.0, 1.0, 0.3), (12.2, 3.1, 0.9), (10.0, 2.0, 0.3)])
    pyramid = Pyramid.of(map_of(walls, seen), 0)
    ends, shift = beams_at(walls, TRUTH).ends, np.array([9.0, 1.0, 0.0])
    search, guess = BranchAndBound(), off(TRUTH, 3.9, 0.3, 0.1)
    found = search.search(pyramid, guess, None, ends)
    first, second = sorted([found.pose, found.runner_up_pose], key=lambda pose: pose[0])
    assert_near(first, TRUTH)
    assert_near(second, TRUTH + shift)
    assert found.runner_up_score > 0.9 * found.score
    # Certain to 0.3 m across the way between them, and to 1.6 m along it: 3.9 m are within the gate, 5.1 m are not
    turn = math.atan2(1, 9)
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    covariance = rotation @ np.diag([1.6, 0.3, 0.1]) ** 2 @ rotation.T
    gated = search.search(pyramid, guess, covariance, ends)
    assert_near(gated.pose, TRUTH)
    assert gated.runner_up_score < 0.8 * gated.score
    gated = search.search(pyramid, off(guess, 1.2, 0.1, 0.0), covariance, ends)
    assert_near(gated.pose, TRUTH + shift)
    assert search.search(pyramid, off(guess, 0.3, -1.5, 0.0), covariance, ends) is None


def test_along_a_bare_corridor_the_next_part_is_another_place():
    walls = np.array([[-15, -1, 15, -1], [-15, 1, 15, 1]], float)
    poses = [(x, 0.0, 0.0) for x in range(-12, 13, 3)]
    pyramid = Pyramid.of(map_of(walls, poses, 5.0), 0)
    search = BranchAndBound(window_m=3.0)
    found = search.search(pyramid, np.array([0.3, 0.2, 0.1]), None, beams_at(walls, (0.0, 0.0, 0.0), 5.0).ends)
    assert abs(found.pose[1]) < 2 * CELL
    assert abs(found.runner_up_pose[1]) < 2 * CELL
    assert found.runner_up_score > 0.95 * found.score
    assert abs(found.runner_up_pose[0] - found.pose[0]) > search.runner_up_distance_m - CELL


def test_where_nothing_fits_nothing_is_found(pyramid):
    search, ends = BranchAndBound(), beams_at(ROOM, TRUTH).ends
    assert search.search(pyramid, np.array([500.0, -300.0, 1.0]), None, ends) is None
    assert search.search(pyramid, TRUTH, None, ends[:0]) is None
    assert search.search(pyramid, TRUTH, None, 3 * ends) is None
    assert search.search(Pyramid.of(OccupancyGridMapping().empty(1), 0), TRUTH, None, ends) is None
    assert BranchAndBound(min_score=1.0).search(pyramid, TRUTH, None, ends) is None


def test_a_certain_guess_is_only_looked_up(pyramid):
    """The pose of the lattice that is nearest is tried whatever the covariance, and no far one."""
    ends = beams_at(ROOM, TRUTH).ends
    for covariance in (np.zeros((3, 3)), 1e-12 * np.eye(3), np.diag([0.0, 0.0, 1e-6])):
        assert_near(BranchAndBound().search(pyramid, TRUTH, covariance, ends).pose, TRUTH)
        away = off(TRUTH, 0.4, 0.2)
        found = BranchAndBound(min_score=0.1).search(pyramid, away, covariance, ends)
        assert_near(found.pose, away)
        assert found.score < 0.6
    unbounded = BranchAndBound().search(pyramid, off(TRUTH, 5.0, 3.0, 0.2), 1e9 * np.eye(3), ends)
    assert_near(unbounded.pose, TRUTH)


def test_points_of_several_scans_find_what_one_does(pyramid):
    """Seen from the last of them, more points than are searched."""
    way = [off(TRUTH, -0.6, 0.1, 0.5), off(TRUTH, -0.3, 0.1, -0.4), TRUTH]
    c, s = math.cos(TRUTH[2]), math.sin(TRUTH[2])
    points = []
    for pose in way:
        a, b = math.cos(pose[2]), math.sin(pose[2])
        points.append((beams_at(ROOM, pose).ends @ [[a, b], [-b, a]] + (pose - TRUTH)[:2]) @ [[c, -s], [s, c]])
    found = BranchAndBound().search(pyramid, off(TRUTH, 7.0, -4.0, 0.3), None, np.concatenate(points))
    assert_near(found.pose, TRUTH)


def test_a_map_far_from_the_origin_is_searched_alike():
    """By whole tiles on every side of it, negative cells included."""
    one = None
    for shift in (np.array([16.0, 32.0]), np.array([-160.0, -48.0])):
        walls = ROOM + np.tile(shift, 2)
        pyramid = Pyramid.of(map_of(walls, [off(np.append(shift, 0), 1.0, 1.0, 0.3)]), 0)
        truth = TRUTH + np.append(shift, 0)
        found = BranchAndBound().search(pyramid, off(truth, 2.0, -1.0, 0.2), None, beams_at(walls, truth).ends)
        here = found.pose - np.append(shift, 0)
        np.testing.assert_allclose(here, here if one is None else one, atol=1e-9)
        one = here
        assert_near(here, TRUTH)


def test_likelihoods_are_the_weights_of_the_distances(room, pyramid):
    field, corner = room.field(0)
    assert pyramid.corner == corner
    likelihood = pyramid.cells[16:-16, 16:-16]
    assert likelihood.shape == field.shape
    distance_m = room.reach_m * (1 - field / 255)
    expected = np.where(field > 0, 255 / (1 + (distance_m / 0.1) ** 2), 0)
    assert np.abs(likelihood - expected).max() <= 0.5 + 1e-9
    occupied = np.argwhere(field == 255) + corner
    ends = TRUTH[:2] + beams_at(ROOM, TRUTH).ends @ [[math.cos(0.9), math.sin(0.9)], [-math.sin(0.9), math.cos(0.9)]]
    hit = {tuple(cell) for cell in cells_of(ends, CELL).tolist()} & {tuple(cell) for cell in occupied.tolist()}
    assert len(hit) > 30


@given(st.integers(0, 2**32), st.integers(4, 300), st.integers(0, 1000))
@settings(deadline=None, max_examples=30)
def test_thinned_points_are_few_even_and_from_among_the_given(seed, most, count):
    """One in each square of a grid that leaves few enough, while the next finer one does not."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 2)) * rng.choice([0.02, 1.0, 30.0], (count, 1))
    few = thin_points(points, most)
    assert len(few) <= most
    indices = [int(np.flatnonzero((points == point).all(axis=1))[0]) for point in few]
    assert indices == sorted(set(indices))
    grids = [np.floor(points * (1 / (0.05 * 1.1**k))) for k in range(100)]
    sizes = [math.inf, *(len(np.unique(grid, axis=0)) for grid in grids)]
    coarsest = [k for k in range(100) if sizes[k + 1] <= most < sizes[k]]
    assert any(len(few) == sizes[k + 1] == len(np.unique(grids[k][indices], axis=0)) for k in coarsest)


def test_few_points_are_all_kept():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-0.3, 0.2], [5.0, 5.0]])
    np.testing.assert_array_equal(thin_points(points, 5), points)
    assert thin_points(points[:0], 5).shape == (0, 2)


@pytest.mark.parametrize(
    ("argument", "change"),
    [
        ("guess", {"guess": np.array([np.nan, 0, 0])}),
        ("points", {"points": np.array([[1.0, np.inf]])}),
        ("covariance", {"covariance": np.diag([1.0, -1.0, 1.0])}),
        ("covariance", {"covariance": np.diag([1.0, np.nan, 1.0])}),
        ("covariance", {"covariance": np.eye(2)}),
    ],
)
def test_bad_arguments_are_named(pyramid, argument, change):
    good = {"guess": TRUTH, "covariance": None, "points": np.ones((3, 2))}
    with pytest.raises(ArgumentError, match=argument):
        BranchAndBound().search(pyramid, **{**good, **change})


@pytest.mark.parametrize("bad", [{"max_points": 257}, {"min_score": 0.0}, {"window_rad": 4.0}, {"step": 1}])
def test_bad_parameters_are_refused(bad):
    with pytest.raises((ConfigurationError, TypeError)):
        BranchAndBound(**bad)
