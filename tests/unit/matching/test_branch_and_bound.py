"""The search in large windows: places found from afar, others told apart from them, and none where there is none."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.geometry.angles import wrap
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
    return LaserScan.from_ranges(0, ranges(walls, np.asarray(pose)), GEOMETRY).beams(
        0.05, range_max_m, Thinning(1_000_000)
    )


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
