"""The covariance of a matched pose: what the scan determines, what it does not, and what beams share."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.localization import KnownMap, match_covariance
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.types import Beams, LaserScan, OccupancyGrid, ScanGeometry

MATCHER = GaussNewton(point_to_line=False)
BELIEF = np.diag([0.04, 0.04, 0.01])
HERE = np.array([10.0, 1.53, 0.0])


def corridor(*, end: bool) -> KnownMap:
    """20 m x 3 m along x; its end is a wall, or open."""
    cells = np.full((61, 401), -4.0, np.float32)
    cells[[0, -1]] = 4.0
    if end:
        cells[:, 300] = 4.0
    return KnownMap(OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (0.0, 0.0)))


def seen_from(known: KnownMap, pose: np.ndarray, beams: int, noise_m: float = 0.0) -> Beams:
    bearings = np.linspace(-math.pi / 2, math.pi / 2, beams)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    ranges = known.cast_rays(np.zeros(1), pose[None], np.zeros(2), directions, 8.0)[0].astype(float)
    ranges += noise_m * np.random.default_rng(0).standard_normal(beams)
    scan = LaserScan.from_ranges(0, ranges, ScanGeometry(bearings), range_max_m=7.9)
    return scan.beams(0.05, 7.9)


def covariance(known: KnownMap, beams: Beams) -> np.ndarray:
    return match_covariance.compute_match_covariance(known, MATCHER, HERE, BELIEF, beams)


def test_along_a_bare_corridor_the_belief_stays_and_across_it_does_not():
    known = corridor(end=False)
    found = covariance(known, seen_from(known, HERE, 181, 0.02))
    assert found[0, 0] == pytest.approx(BELIEF[0, 0], rel=0.05)
    assert found[1, 1] < 0.05**2
    assert found[2, 2] < 0.1 * BELIEF[2, 2]
    ended = corridor(end=True)
    assert covariance(ended, seen_from(ended, HERE, 181, 0.02))[0, 0] < 0.05**2


def test_beams_that_end_in_one_place_count_once(monkeypatch):
    """Four times as many beams on the same walls are no four times better, as the map's error is one."""
    known = corridor(end=True)
    few, many = (covariance(known, seen_from(known, HERE, count, 0.02)) for count in (91, 361))
    assert 0.5 < many[1, 1] / few[1, 1] < 1.5
    monkeypatch.setattr(match_covariance, "_PATCH_M", 1e-4)
    few, many = (covariance(known, seen_from(known, HERE, count, 0.02)) for count in (91, 361))
    assert many[1, 1] / few[1, 1] < 0.35
