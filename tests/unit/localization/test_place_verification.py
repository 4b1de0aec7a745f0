"""A place is found only if no other one explains the last scans as well."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.geometry.se2 import compose
from gridslam.localization import KnownMap
from gridslam.localization.belief import NO_HYPOTHESES, PoseHypotheses, join_hypotheses
from gridslam.localization.monte_carlo import MonteCarloConfiguration, MonteCarloLocalization
from gridslam.localization.place_verification import (
    NO_SCANS,
    RecentScans,
    bound_outside_log_odds,
    compute_outside_log_odds,
    find_rivals,
)
from gridslam.types import OccupancyGrid, StoredScan

BEARINGS = np.linspace(-math.pi / 2, math.pi / 2, 61)
LASER = np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])
HERE, STEP = np.array([2.0, 1.5, 0.0]), np.array([0.2, 0.0, 0.0])


def two_rooms(*, with_post: bool) -> KnownMap:
    """Two equal rooms of 6 m x 3 m side by side; a post stands in the corner of the first, behind a robot at `HERE`."""
    cells = np.full((61, 241), -4.0, np.float32)
    cells[[0, -1]] = cells[:, [0, 120, -1]] = 4.0
    cells[40:50, 80:90] = cells[40:50, 200:210] = 4.0
    if with_post:
        cells[8:14, 24:30] = 4.0
    return KnownMap(OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (0.0, 0.0)))


def seen_from(known: KnownMap, pose: np.ndarray) -> np.ndarray:
    ranges = known.cast_rays(np.zeros(1), pose[None], np.zeros(2), LASER, 20.0)[0]
    return LASER * ranges[:, None]


def verify(known: KnownMap, recent: RecentScans, pose: np.ndarray) -> tuple[PoseHypotheses, float]:
    found, alike_m = find_rivals(known, pose, recent, lambda guesses: guesses, np.random.default_rng(0))
    return join_hypotheses(NO_HYPOTHESES, found, pose), alike_m  # without what it found where the robot is


def drive(known: KnownMap, start: np.ndarray, steps: int) -> tuple[RecentScans, np.ndarray]:
    recent, pose = NO_SCANS, start
    for k in range(steps):
        recent = recent.append(STEP, StoredScan(seen_from(known, pose), np.zeros(2)), 48)
        pose = compose(pose, STEP) if k + 1 < steps else pose
    return recent, pose


def test_a_scan_that_was_taken_earlier_refutes_it():
    """The post is out of sight by now; scans of the way to here saw it."""
    known = two_rooms(with_post=True)
    recent, pose = drive(known, HERE - [1.6, 0.9, 0.0], 14)
    assert verify(known, RecentScans(recent.poses[-1:], recent.ends[-1:], recent.origins[-1:]), pose)[0].odds > 0.3
    assert verify(known, recent, pose)[0].odds < 0.05


def test_how_long_places_of_a_map_look_alike_bounds_how_certain_it_is_that_the_robot_is_inside():
    """Without the post the other room is not told from this one on all of the way, with it since it was seen."""
    rooms = two_rooms(with_post=False), two_rooms(with_post=True)
    alike_m = [verify(known, *drive(known, HERE - [1.6, 0.9, 0.0], 14))[1] for known in rooms]
    assert alike_m[0] == pytest.approx(2.6), "all of the way"
    assert 0 < alike_m[1] < 0.6 * alike_m[0]
    bounds = [bound_outside_log_odds(-5.0, 2.6, one) for one in (*alike_m, 0.0)]
    assert bounds[0] > bounds[1] > bounds[2] == -5


def half_hall() -> tuple[KnownMap, KnownMap]:
    """A hall of 12 m x 3 m without an inner wall, and a map of its first 6 m as the room that it is not."""
    cells = np.full((61, 241), -4.0, np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 4.0
    wrong = cells[:, :121].copy()
    wrong[:, -1] = 4.0
    return tuple(KnownMap(OccupancyGrid(some, np.ones(some.shape, bool), 0.05, (0.0, 0.0))) for some in (cells, wrong))


def outside_log_odds(known: KnownMap, recent: RecentScans, pose: np.ndarray) -> float:
    return compute_outside_log_odds(known, pose, recent, np.random.default_rng(0))


def test_beams_through_walls_say_that_the_robot_is_outside_the_map():
    """The end of the hall is seen through the wall of the room; from the room's own scans it is not."""
    hall, room = half_hall()
    assert outside_log_odds(room, *drive(hall, HERE, 14)) > 5
    assert outside_log_odds(room, *drive(room, HERE, 14)) < -2
    assert outside_log_odds(room, *drive(room, HERE, 3)) > 0, "a few scans do not tell"


def test_what_stands_before_the_walls_does_not_say_that_the_robot_is_outside_the_map():
    """A map of another year: a wall that is new hides half of the hall."""
    hall, room = half_hall()
    assert outside_log_odds(hall, *drive(room, HERE, 14)) < -2


def test_a_given_pose_is_not_verified_and_a_found_one_is():
    mcl = MonteCarloLocalization(two_rooms(with_post=False), MonteCarloConfiguration())
    rng = np.random.default_rng(0)
    assert mcl.init_gaussian(HERE, np.eye(3) * 1e-4, rng).verified
    assert not mcl.init().verified
