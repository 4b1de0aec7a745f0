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
