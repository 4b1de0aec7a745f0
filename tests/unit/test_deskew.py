"""Motion during a scan, undone: beams against the exact motion of the base, each at its own time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.types import LaserScan, ScanGeometry

RATES = st.floats(-5, 5)
TWISTS = st.tuples(RATES, RATES, st.one_of(RATES, st.floats(-1e-9, 1e-9)))


def scan_of(rng, times=None, beams=40):
    geometry = ScanGeometry.planar(np.sort(rng.uniform(-3, 3, beams)), [0.3, -0.2, 2.0])
    return LaserScan.from_ranges(0, rng.uniform(0.0, 12.0, beams), geometry, range_max_m=10.0, beam_times_s=times)


@given(TWISTS, st.integers(0, 2**32 - 1))
def test_each_end_lies_where_the_base_was_at_its_time(twist, seed):
    rng = np.random.default_rng(seed)
    times = rng.uniform(-0.2, 0.2, 40)
    beams = scan_of(rng, times).beams(0.5, 8.0)
    moved = se2.exp(times[beams.indices, None] * np.array(twist))
    deskewed = beams.deskew(np.array(twist))
    assert deskewed.ends.shape == beams.ends.shape
    np.testing.assert_allclose(deskewed.ends, se2.transform_points(moved, beams.ends), atol=1e-13)
    lasers = se2.transform_points(moved, beams.origin)
    np.testing.assert_allclose(deskewed.origin, lasers.mean(axis=0), atol=1e-13)
    assert deskewed.scan is beams.scan
    assert deskewed.indices is beams.indices


def test_a_wall_seen_while_turning_is_straight_again():
    """A base that drives and turns at 3 rad/s before the wall x = 4, its laser off-centre: 0.1 s smear it by 0.9 m."""
    bearings, times = np.linspace(-0.9, 0.9, 200), np.linspace(0.0, 0.1, 200)
    twist, mounting = np.array([0.5, 0.0, 3.0]), np.array([0.4, 0.1, 0.2])
    lasers = se2.compose(se2.exp(times[:, None] * twist), mounting)
    ranges = (4.0 - lasers[:, 0]) / np.cos(lasers[:, 2] + bearings)
    scan = LaserScan.from_ranges(0, ranges, ScanGeometry.planar(bearings, mounting), beam_times_s=times)
    skewed = scan.beams(0.05, 30.0)
    assert np.ptp(skewed.ends[:, 0]) > 0.9
    np.testing.assert_allclose(skewed.deskew(twist).ends[:, 0], 4.0, atol=1e-12)


def test_rays_begin_within_half_the_way_of_the_laser():
    rng = np.random.default_rng(1)
    twist = np.array([0.4, 0.0, 0.0])
    beams = scan_of(rng, np.linspace(0, 0.1, 40)).beams(0.05, 30.0).deskew(twist)
    assert beams.origin[0] - beams.scan.geometry.origin[0] == pytest.approx(0.02, abs=0.005)  # a few beams are invalid


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_time_that_is_not_finite_is_refused(wrong):
    with pytest.raises(ArgumentError, match="beam_times_s: expected finite"):
        scan_of(np.random.default_rng(4), [wrong] * 40)
