"""Sharpness of walls: the noise of two beams at exact poses, and what poses are wrong by besides."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.grid.scan_batch import ScanBatch
from gridslam.matching.beam_order import BeamOrder
from gridslam.matching.sharpness import measure_sharpness
from gridslam.matching.surfaces import Surfaces
from gridslam.types import LaserScan, ScanGeometry, StoredScan

_WIDE, _HIGH = 12.0, 8.0  # a room about the origin
_NOISE_M = 0.01
_LAPS = 2
_STEPS = 24


def _laps() -> np.ndarray:
    turns = np.linspace(0, _LAPS * math.tau, _LAPS * _STEPS, endpoint=False)
    return np.column_stack([3 * np.cos(turns), 2 * np.sin(turns), turns + math.pi / 2])


def _surfaces(poses: np.ndarray, noise_m: float) -> Surfaces:
    rng = np.random.default_rng(3)
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False) + 1e-3
    scans = []
    for x, y, theta in poses:
        way = np.column_stack([np.cos(bearings + theta), np.sin(bearings + theta)])
        room = np.where(way > 0, [_WIDE / 2 - x, _HIGH / 2 - y], [-_WIDE / 2 - x, -_HIGH / 2 - y])
        ranges = (room / way).min(axis=1) + rng.normal(0, noise_m, len(bearings))
        ends = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        scans.append(StoredScan(ends, np.zeros(2)))
    return Surfaces.of(ScanBatch.of(scans))


def _shift_second_lap(poses: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    return poses + np.where(np.arange(len(poses)) < _STEPS, 0.0, 1.0)[:, None] * [x_m, y_m, 0.0]


def test_exact_poses_leave_the_noise_of_two_beams():
    """Points and the surfaces' points err independently, on oblique walls less along their normals."""
    poses = _laps()
    sharpness_m = measure_sharpness(_surfaces(poses, _NOISE_M), poses)
    assert 0.6 * math.sqrt(2) * _NOISE_M < sharpness_m < math.sqrt(2) * _NOISE_M


@pytest.mark.parametrize("shift_m", [0.02, 0.05, 0.1])
def test_doubled_walls_are_as_far_apart_as_the_visits(shift_m):
    """Half of the walls are along each axis, so that a shift by both is seen in full."""
    poses = _laps()
    moved = measure_sharpness(_surfaces(poses, 0.0), _shift_second_lap(poses, shift_m, shift_m))
    assert moved == pytest.approx(shift_m, rel=0.05)


def test_one_visit_has_nothing_to_compare_with():
    poses = _laps()[: _STEPS * 3 // 4]
    assert measure_sharpness(_surfaces(poses, _NOISE_M), poses) is None


def test_scans_of_a_standing_robot_count_once():
    poses = _laps()
    wrong = _shift_second_lap(poses, 0.05, 0.05)
    trembles = np.random.default_rng(4).normal(0, [0.001, 0.001, 0], (200, 3))
    waits = np.concatenate([wrong, poses[-1] + trembles])  # without the shift
    drive = measure_sharpness(_surfaces(poses, 0.0), wrong)
    waited = measure_sharpness(_surfaces(np.concatenate([poses, np.tile(poses[-1:], (200, 1))]), 0.0), waits)
    assert waited == pytest.approx(drive, rel=0.1)


TIMES = np.array([0.0, 0.05, 0.1])


def ratios(gains):
    """Inlier ratios by what an order gains over the reported one."""
    return {order: 0.6 + gain for order, gain in zip((1, 0, -1), (0.0, *gains), strict=True)}


@pytest.mark.parametrize(
    ("gains", "best"), [((0.0, 0.0), 1), ((0.04, 0.04), 1), ((0.1, 0.2), -1), ((0.2, 0.1), 0), ((-0.1, 0.04), 1)]
)
def test_another_order_than_the_reported_one_must_fit_better_by_a_margin(gains, best):
    assert BeamOrder().add(*ratios(gains).values()).best(0.05) == best


def test_a_scan_teaches_the_order_if_it_has_times_and_the_robot_turns():
    scan = LaserScan.from_ranges(0, np.full(3, 2.0), ScanGeometry(np.array([-0.5, 0.0, 0.5])), beam_times_s=TIMES)
    beams = scan.beams(0.1, 29.0)
    fast = np.array([0.2, 0.0, 1.0])
    seen = []

    def inlier_ratio(one):
        seen.append(one.ends)
        return 0.1 * len(seen)

    order = BeamOrder().learn(beams, fast, inlier_ratio)
    assert order == pytest.approx((1.0, 0.1, 0.2))
    for ends, sign in zip(seen, (1, 0, -1), strict=True):
        np.testing.assert_array_equal(ends, beams.deskew(sign * fast).ends)
    assert order.learn(beams, np.array([0.2, 0.0, 0.19]), inlier_ratio) is order  # 0.019 rad in a scan
    untimed = LaserScan.from_ranges(0, np.full(3, 2.0), scan.geometry).beams(0.1, 29.0)
    assert order.learn(untimed, fast, inlier_ratio) is order
