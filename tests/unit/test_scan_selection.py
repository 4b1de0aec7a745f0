"""Which beams of a scan are used: what hit within the limits, and of dense scans one for each bit of arc."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.scan import Thinning
from gridslam.types import LaserScan, ScanGeometry


def scan_of(ranges, bearings, **limits) -> LaserScan:
    return LaserScan.from_ranges(0, ranges, ScanGeometry(bearings), **limits)


def turn(beams: int) -> np.ndarray:
    return np.linspace(-math.pi, math.pi, beams, endpoint=False)


@given(st.integers(0, 2**32 - 1), st.integers(1, 400))
def test_a_scan_that_is_not_dense_is_used_as_a_whole(seed, beams):
    rng = np.random.default_rng(seed)
    values = rng.choice([0.0, -1.0, np.nan, np.inf, 0.02, 3.0, 30.0, 190.0], beams).astype(np.float32)
    scan = scan_of(values, rng.uniform(-4, 4, beams))
    used = scan.beams(0.05, 30.0)
    assert used.indices.tolist() == [k for k, value in enumerate(values.tolist()) if 0.05 <= value < 30.0]
    expected = np.stack([np.cos(scan.geometry.bearings), np.sin(scan.geometry.bearings)], axis=1)[used.indices] * 3.0
    np.testing.assert_allclose(used.ends, expected, atol=1e-12)


@pytest.mark.parametrize("beams", [1081, 4000, 100_000])
@pytest.mark.parametrize("direction", [1, -1])
def test_of_a_dense_scan_beams_are_taken_at_equal_steps_of_arc(beams, direction):
    """Half of them at 2 m, half at 8 m: by bearing there were as many of both, by arc there are four times as many."""
    bearings = turn(beams)[::direction]
    used = scan_of(np.where(np.abs(bearings) < math.pi / 2, 2.0, 8.0), bearings).beams(0.05, 30.0)
    near = np.hypot(*used.ends.T) < 5
    arc, pitch = math.pi * 10, math.tau / beams
    steps = np.hypot(*np.diff(used.ends, axis=0).T)
    inner = near[1:] == near[:-1]
    assert steps[inner].max() < 0.025 + 2 * 8 * pitch  # what is left of one part, and one beam more
    assert (arc / 0.025 - 2 if beams == 100_000 else 400) <= len(used) <= arc / 0.025 + 2
    if beams == 100_000:
        assert (~near).sum() / near.sum() == pytest.approx(4, rel=0.02)


def test_where_all_is_near_as_many_beams_are_kept_as_scans_have_that_are_not_dense():
    used = scan_of(np.full(5000, 0.3), turn(5000)).beams(0.05, 30.0)  # 1.9 m of arc: 75 parts of 2.5 cm
    assert 399 <= len(used) <= 401
    assert np.ptp(np.diff(used.indices)) <= 1  # spread evenly


def test_without_a_spacing_all_are_used():
    assert len(scan_of(np.full(5000, 3.0), turn(5000)).beams(0.05, 30.0, Thinning(0.0))) == 5000


def test_what_counts_as_dense_is_a_parameter():
    scan = scan_of(np.full(400, 0.3), turn(400))
    assert len(scan.beams(0.05, 30.0)) == 400
    assert 99 <= len(scan.beams(0.05, 30.0, Thinning(dense_beams=100))) <= 101


def test_only_usable_beams_count():
    """A dense scan with few usable beams keeps them all."""
    ranges = np.full(5000, np.nan)
    ranges[::20] = 3.0
    used = scan_of(ranges, turn(5000)).beams(0.05, 30.0)
    assert used.indices.tolist() == list(range(0, 5000, 20))
    assert len(scan_of(np.full(5000, np.nan), turn(5000)).beams(0.05, 30.0)) == 0


@given(st.integers(0, 2**32 - 1))
def test_any_dense_scan_gives_some_of_its_beams_in_their_order(seed):
    rng = np.random.default_rng(seed)
    beams = int(rng.integers(401, 3000))
    bearings = rng.uniform(-7, 7, beams) if seed % 2 else np.full(beams, 0.1)  # in no order, or all the same
    scan = scan_of(rng.uniform(-1, 40, beams).astype(np.float32), bearings)
    every, used = scan.beams(0.05, 30.0, Thinning(0.0)), scan.beams(0.05, 30.0)
    assert used.indices[0] == every.indices[0]
    assert (np.diff(used.indices) > 0).all()
    kept = np.isin(every.indices, used.indices)
    np.testing.assert_array_equal(used.ends, every.ends[kept])


def test_widths_are_the_angles_between_neighbours():
    np.testing.assert_allclose(ScanGeometry(turn(8)).widths, math.pi / 4)
    np.testing.assert_allclose(ScanGeometry(turn(8)[::-1]).widths, math.pi / 4)
    np.testing.assert_allclose(ScanGeometry([0.0, 0.1, 0.3]).widths, [0.3, 0.1, 0.2], rtol=1e-12)
    assert ScanGeometry([1.0]).widths.tolist() == [0.0]
