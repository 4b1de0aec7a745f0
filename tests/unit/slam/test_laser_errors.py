"""Systematic errors of a laser, from scans of a room whose poses are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.grid.scan_batch import ScanBatch
from gridslam.matching.surfaces import Surfaces
from gridslam.slam.full_slam.laser_errors import estimate_laser_errors
from gridslam.types import StoredScan

_WIDE, _HIGH = 8.0, 6.0  # a room about the origin
_NOISE_M = 0.01
_SCANS = 60
_PAIRS = np.array([(a, b) for b in range(_SCANS) for a in range(max(0, b - 16), b, 4)])


def _poses() -> np.ndarray:
    turns = np.linspace(0, math.tau, _SCANS, endpoint=False)
    return np.column_stack([2 * np.cos(turns), 1.5 * np.sin(turns), turns + math.pi / 2])


def _surfaces(offset_m: float, scale: float, origins: np.ndarray) -> Surfaces:
    rng = np.random.default_rng(5)
    bearings = np.radians(np.arange(-90.0, 90.0) + 0.1)
    scans = []
    for (x, y, theta), origin in zip(_poses(), origins, strict=True):
        way = np.column_stack([np.cos(bearings + theta), np.sin(bearings + theta)])
        room = np.where(way > 0, [_WIDE / 2 - x, _HIGH / 2 - y], [-_WIDE / 2 - x, -_HIGH / 2 - y])
        ranges = (room / way).min(axis=1) + rng.normal(offset_m, _NOISE_M, len(bearings))
        told = (1 + scale) * bearings
        scans.append(StoredScan(np.column_stack([ranges * np.cos(told), ranges * np.sin(told)]) + origin, origin))
    return Surfaces.of(ScanBatch.of(scans), 0.15)


@pytest.mark.parametrize(("offset_m", "scale"), [(0.0, 0.0), (0.02, 0.0), (-0.02, 0.0), (0.0, 0.0056), (0.01, -0.0056)])
def test_errors_are_found_within_four_standard_deviations(offset_m, scale):
    found = estimate_laser_errors(_surfaces(offset_m, scale, np.zeros((_SCANS, 2))), _poses(), _PAIRS)
    assert found.range_offset_sigma_m < 0.002
    assert found.bearing_scale_sigma < 0.001
    assert abs(found.range_offset_m - offset_m) < 4 * found.range_offset_sigma_m
    assert abs(found.bearing_scale - scale) < 4 * found.bearing_scale_sigma


def test_few_pairs_and_several_lasers_determine_nothing():
    surfaces = _surfaces(0.02, 0.0, np.zeros((_SCANS, 2)))
    assert estimate_laser_errors(surfaces, _poses(), _PAIRS[:10]) is None
    two = _surfaces(0.02, 0.0, np.arange(2 * _SCANS).reshape(-1, 2) % 4 * 0.1)
    assert estimate_laser_errors(two, _poses(), _PAIRS) is None
