"""The map of localization: distances, rays, free space and tabulated models, against brute force and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.localization import KnownMap
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.models.endpoint import CauchyEndPoint, LikelihoodField
from gridslam.types import Beams, LaserScan, OccupancyGrid, ScanGeometry

CELL = 0.1
ORIGIN = (-1.0, 2.0)


def grid_of(cells: np.ndarray) -> OccupancyGrid:
    """0 free, 1 occupied, 2 unknown."""
    return OccupancyGrid(np.where(cells == 1, 4.0, -4.0).astype(np.float32), cells != 2, CELL, ORIGIN)


def room() -> np.ndarray:
    """4 m x 3 m of free space with walls around it, and an unknown part at the left."""
    cells = np.zeros((32, 52), int)
    cells[:, :10] = 2
    cells[[0, -1], 10:] = cells[:, [10, -1]] = 1
    return cells


def scan_of(ends: np.ndarray) -> LaserScan:
    geometry = ScanGeometry(np.arctan2(ends[:, 1], ends[:, 0]))
    return LaserScan.from_ranges(0, np.hypot(*ends.T), geometry, range_max_m=29.0)


def test_distances_are_those_to_the_nearest_occupied_centre():
    cells = room()
    known, rng = KnownMap(grid_of(cells), reach_m=0.75), np.random.default_rng(0)
    centres = (np.argwhere(cells == 1)[:, ::-1] + 0.5) * CELL + ORIGIN
    poses = np.column_stack([rng.uniform([-1.5, 1.5], [5, 6], (40, 2)), rng.uniform(-3, 3, 40)])
    points = rng.uniform(-1, 1, (7, 2))
    found = known.distances(np.zeros(40, np.int32), poses, points)
    for k, (x, y, theta) in enumerate(poses):
        turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
        ends = points @ turn.T + [x, y]
        exact = np.minimum(np.hypot(*(ends[:, None] - centres).transpose(2, 0, 1)).min(axis=1), 0.75)
        # Between centres the field is interpolated: its bends, at obstacles and at the reach, are cut by half a cell's
        # diagonal at most.
        np.testing.assert_allclose(found[k], exact, atol=CELL / math.sqrt(2))
    far = known.distances(np.zeros(1), np.array([[90.0, -90, 0]]), points)
    np.testing.assert_allclose(far, 0.75, rtol=1e-6)


@pytest.mark.parametrize("sensor", [LikelihoodField(tempering=0.3), CauchyEndPoint(tempering=0.2)])
def test_a_tabulated_model_says_what_the_model_says(sensor):
    known, rng = KnownMap(grid_of(room())), np.random.default_rng(1)
    beams = scan_of(rng.uniform(-2, 2, (50, 2))).beams(0.01, 29.0)
    poses = np.column_stack([rng.uniform([0.5, 2.5], [4, 5], (200, 2)), rng.uniform(-3, 3, 200)])
    blurred = sensor
    if isinstance(sensor, LikelihoodField):  # the map's rounding to cells is noise, too
        blurred = replace(sensor, sigma_hit_m=math.hypot(sensor.sigma_hit_m, CELL / math.sqrt(12)))
    exact = blurred(beams)(known, np.zeros(200, np.int32), poses)
    tabulated = known.condition(sensor, beams)(poses)
    # One interpolates the distance, the other what it means: they differ between centres, not in the mean.
    assert np.corrcoef(exact, tabulated)[0, 1] > 0.98
    assert abs(np.mean(exact - tabulated)) < 0.1 * sensor.tempering * 50


def seen_from(known: KnownMap, pose: np.ndarray) -> Beams:
    """What a laser of 120 beams measures there, to the centres of the walls' cells."""
    bearings = np.linspace(-2.5, 2.5, 120)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    ranges = known.cast_rays(np.zeros(1), pose[None], np.zeros(2), directions, 30.0)[0]
    return LaserScan.from_ranges(0, ranges, ScanGeometry(bearings)).beams(0.01, 29.0)


LINES = GaussNewton(point_to_line=False)


@given(st.integers(0, 2**32 - 1))
def test_a_scan_is_matched_to_where_it_was_taken(seed):
    """Rays end where they pass the centres of cells, up to half a cell aside: 120 beams average that out."""
    known, rng = KnownMap(grid_of(room())), np.random.default_rng(seed)
    truth = rng.uniform([0.6, 2.6, -3], [3.6, 4.6, 3])
    guess = truth + rng.uniform(-1, 1, 3) * [0.1, 0.1, 0.05]
    found = known.match(LINES, guess[None], np.zeros((3, 3)), seen_from(known, truth)).poses[0]
    assert np.hypot(*(found - truth)[:2]) < CELL / 4
    assert abs(found[2] - truth[2]) < 0.02


def test_free_space_is_only_what_is_known_to_be_free():
    cells = room()
    known, rng = KnownMap(grid_of(cells)), np.random.default_rng(2)
    poses = known.sample_poses(20_000, rng)
    assert known.is_free(poses).all()
    column, row = np.floor((poses[:, :2] - ORIGIN) / CELL).astype(int).T
    assert (cells[row, column] == 0).all()
    assert known.free_area_m2 == pytest.approx(np.count_nonzero(cells == 0) * CELL**2)
    # Even over 1200 cells: 16.7 a cell, Poisson, whose chi-square over 1199 degrees has a deviation of 49.
    counts = np.bincount(row * 52 + column, minlength=cells.size).reshape(cells.shape)[cells == 0]
    expected = 20_000 / len(counts)
    assert abs(((counts - expected) ** 2 / expected).sum() - len(counts)) < 5 * math.sqrt(2 * len(counts))
    assert abs(np.exp(1j * poses[:, 2]).mean()) < 5 / math.sqrt(20_000)


@pytest.mark.parametrize("place", [(np.nan, 0.5), (0.5, np.inf), (-np.inf, np.nan), (1e300, 1e300), (-99, 1)])
def test_what_is_no_number_or_beyond_the_map_is_not_free(place):
    assert not KnownMap(grid_of(np.zeros((9, 9), int) + np.eye(9, dtype=int))).is_free(np.array([[*place, 0.0]]))[0]


@pytest.mark.parametrize("log_odds", [-1.0, 0.0, 0.5])
def test_a_cell_of_which_the_map_is_not_sure_is_neither_free_nor_occupied(log_odds):
    grid = grid_of(room())
    odds = grid.log_odds.copy()
    odds[10:20, 20:30] = log_odds
    known = KnownMap(replace(grid, log_odds=odds))
    inside = np.array([[ORIGIN[0] + 2.5, ORIGIN[1] + 1.5, 0.0]])
    assert not known.is_free(inside)[0]
    assert known.distances(np.zeros(1), inside, np.zeros((1, 2)))[0, 0] > 0.9


def test_maps_without_free_or_occupied_cells_are_refused():
    for cells, missing in ((np.ones((5, 5), int), "free"), (np.zeros((5, 5), int), "occupied")):
        with pytest.raises(ArgumentError, match=f"at least one {missing} cell"):
            KnownMap(grid_of(cells))
    with pytest.raises(ArgumentError, match="reach_m"):
        KnownMap(grid_of(room()), reach_m=0.0)


@pytest.mark.parametrize("shape", [(10**6, 1), (10**8, 0), (3,), (3, 2), (1, 3, 3)])
def test_poses_of_another_shape_are_refused(shape):
    with pytest.raises(ArgumentError, match="poses: expected shape"):
        KnownMap(grid_of(room())).is_free(np.zeros(shape))


@pytest.mark.parametrize("max_m", [1e300, np.inf])
@pytest.mark.parametrize("length", [1.0, 1e10, 1e-10, 1e300, 0.0])
@pytest.mark.parametrize("place", [1.5, 1e6, -5e7, 1e300])
def test_rays_end_where_the_map_does(max_m, length, place):
    """From outside, too: as far as a ray is followed nothing is met but the map's walls."""
    cells = np.zeros((60, 60), int)
    cells[[0, -1]] = cells[:, [0, -1]] = 1
    known = KnownMap(OccupancyGrid(grid_of(cells).log_odds, np.ones(cells.shape, np.bool_), 0.05, (0.0, 0.0)))
    found = known.cast_rays(
        np.zeros(2, np.int32), np.array([[1.5, place, 0.3], [place, 1.5, 2.0]]), np.zeros(2), length * np.eye(2), max_m
    )
    assert found.shape == (2, 2)
    if place == 1.5 and length == 1.0:
        assert (found < 3).all()


def test_beams_that_end_where_nothing_is_mapped_are_told_from_those_through_walls():
    """The room is open to the left from x = 0.1 to 0.9, where its wall ends; the other walls are closed."""
    cells = room()
    cells[1:9, 10] = 0
    known, pose, origin = KnownMap(grid_of(cells)), np.array([1.0, 2.5, 0.0]), np.zeros(2)
    ends = np.array([[-1.6, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 0.05], [-1.9, 2.0], [0.0, -0.75]])
    np.testing.assert_array_equal(known.went_through(pose, ends, origin), [0, 0, 1, 0, 1, 0])
    np.testing.assert_array_equal(known.ends_beyond(pose, ends, origin), [1, 0, 0, 0, 0, 1])
