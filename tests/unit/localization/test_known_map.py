"""The map of localization: distances, rays, free space and tabulated models, against brute force and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from gridslam.errors import ArgumentError
from gridslam.localization import KnownMap
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.models.beam import BeamRangeFinder
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


def test_rays_meet_the_walls():
    known = KnownMap(grid_of(room()))
    pose, directions = np.array([[2.0, 3.5, math.pi / 2]]), np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    ranges = known.cast_rays(np.zeros(1), pose, np.zeros(2), directions, 30.0)
    # To the centres of the wall's cells: y 5.15, x 0.05, y 2.05, x 4.15.
    np.testing.assert_allclose(ranges[0], [1.65, 1.95, 1.45, 2.15], atol=1e-6)


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


def test_at_centres_of_cells_both_agree_exactly():
    known, sensor = KnownMap(grid_of(room())), CauchyEndPoint(tempering=1.0)
    beams = scan_of(np.array([[0.3, 0.2], [-0.5, 0.1], [1.0, -0.7]])).beams(0.01, 29.0)
    poses = np.array([[1.05, 3.05, 0.0], [2.35, 4.75, 0.0]])
    exact = sensor(beams)(known, np.zeros(2, np.int32), poses)
    # Both are kept in 255 steps: distances of 1 m, by which agreement changes 6.5 times as fast at most, and agreement.
    np.testing.assert_allclose(known.condition(sensor, beams)(poses), exact, atol=3 * 0.5 * (6.5 + 1) / 255)


def test_the_beam_model_prefers_the_true_pose():
    known = KnownMap(grid_of(room()))
    truth, bearings = np.array([2.0, 3.5, 0.4]), np.linspace(-2, 2, 60)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    ranges = known.cast_rays(np.zeros(1), truth[None], np.zeros(2), directions, 30.0)[0]
    beams = LaserScan.from_ranges(0, ranges, ScanGeometry(bearings)).beams(0.01, 29.0)
    poses = truth + np.array([[0, 0, 0], [0.3, 0, 0], [0, -0.3, 0], [0, 0, 0.2]])
    assert known.condition(BeamRangeFinder(), beams)(poses).argmax() == 0


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


def test_who_is_sure_of_the_guess_keeps_it():
    known, truth = KnownMap(grid_of(room())), np.array([2.0, 3.5, 0.4])
    guess, beams = truth + np.array([0.05, -0.04, 0.03]), seen_from(known, truth)
    np.testing.assert_allclose(known.match(LINES, guess[None], 1e9 * np.eye(3), beams).poses[0], guess, atol=1e-6)
    none = replace(beams, indices=beams.indices[:0], ends=beams.ends[:0])
    np.testing.assert_allclose(known.match(LINES, guess[None], np.zeros((3, 3)), none).poses[0], guess, atol=1e-12)
    off = known.match(GaussNewton(max_iterations=0), guess[None], np.zeros((3, 3)), beams).poses[0]
    np.testing.assert_allclose(off, guess, atol=1e-12)


def test_a_match_does_not_depend_on_where_the_map_lies():
    grid, truth = grid_of(room()), np.array([2.0, 3.5, 0.4])
    known, shift = KnownMap(grid), np.array([-7.123, 40.456, 0.0])
    x, y = (np.array(grid.origin) + shift[:2]).tolist()
    elsewhere = KnownMap(replace(grid, origin=(x, y)))
    guess, beams = truth + np.array([0.05, -0.04, 0.03]), seen_from(known, truth)
    here, there = (
        one.match(LINES, at[None], np.eye(3), beams).poses[0]
        for one, at in ((known, guess), (elsewhere, guess + shift))
    )
    np.testing.assert_allclose(there - shift, here, atol=1e-6)


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


@pytest.mark.parametrize("log_odds", [-1.0, 0.0, 0.5])
def test_a_cell_of_which_the_map_is_not_sure_is_neither_free_nor_occupied(log_odds):
    grid = grid_of(room())
    odds = grid.log_odds.copy()
    odds[10:20, 20:30] = log_odds
    known = KnownMap(replace(grid, log_odds=odds))
    inside = np.array([[ORIGIN[0] + 2.5, ORIGIN[1] + 1.5, 0.0]])
    assert not known.is_free(inside)[0]
    assert known.distances(np.zeros(1), inside, np.zeros((1, 2)))[0, 0] > 0.9


def test_off_the_map_nothing_is_free():
    known = KnownMap(grid_of(room()))
    assert not known.is_free(np.array([[-9.0, 3, 0], [99.0, 3, 0], [2.0, -9, 0], [2.0, 99, 0], [1e12, -1e12, 0]])).any()


def test_maps_without_free_or_occupied_cells_are_refused():
    for cells, missing in ((np.ones((5, 5), int), "free"), (np.zeros((5, 5), int), "occupied")):
        with pytest.raises(ArgumentError, match=f"at least one {missing} cell"):
            KnownMap(grid_of(cells))
    with pytest.raises(ArgumentError, match="reach_m"):
        KnownMap(grid_of(room()), reach_m=0.0)


def test_spread_about_a_pose_is_that_of_poses_drawn_from_the_map():
    free = np.zeros((40, 60), bool)
    free[5:30, 10:50] = free[2:5, 3:8] = True
    cells = np.where(free, -4, 4).astype(np.float32)
    known = KnownMap(OccupancyGrid(cells, np.ones(free.shape, bool), 0.1, (-2.0, 1.0)))
    pose = np.array([0.5, 2.0, 0.0])
    away = known.sample_poses(200_000, np.random.default_rng(0)) - pose
    # Cells count by their centres: they leave out the 0.1^2 / 12 that a cell is wide.
    np.testing.assert_allclose(known.spread_about(pose), away.T @ away / len(away), atol=0.03)


@pytest.mark.parametrize(("share", "reach_m"), [(0.01, 2.0), (0.3, 0.1), (0.0003, 9.0), (0.05, 0.75)])
def test_distances_are_those_of_the_exact_transform(share, reach_m):
    """Of a map of several bands of rows."""
    occupied = np.random.default_rng(1).random((150, 130)) < share
    occupied[70, 5] = True
    known = KnownMap(grid_of(occupied.astype(int)), reach_m=reach_m)
    exact = distance_transform_edt(~np.pad(occupied, known._rim)) * CELL
    np.testing.assert_allclose(known._distances, np.minimum(exact, reach_m), rtol=1e-6)


def test_the_spread_is_that_of_the_free_cells():
    known = KnownMap(grid_of(room()))
    cells = np.argwhere(room() == 0)[:, ::-1]
    middle = (cells.mean(axis=0) + 0.5) * CELL + ORIGIN
    spread = known.spread_about(np.array([*middle, 0.0]))
    np.testing.assert_allclose(spread[:2, :2], np.cov(cells.T, bias=True) * CELL**2, rtol=1e-9)
