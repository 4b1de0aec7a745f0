"""Motion during a scan, undone: beams against the exact motion of the base, each at its own time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from closure_errors import closure_errors, false_closures
from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.geometry.se2 import between, compose
from gridslam.scan import Thinning
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


TRUTH = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, math.pi / 2], [2.0, 4.0, math.pi - 0.01], [-1.0, 0.0, -3.0]])
reals = st.floats(-50, 50)
poses = st.tuples(reals, reals, st.floats(-math.pi, math.pi))


def test_errors_by_hand():
    # From (2, 1), looking along y, the place (2, 4) is 3 m ahead.
    metres, radians = closure_errors(TRUTH, [[1, 2], [1, 2]], [[3.0, 0.0, math.pi / 2], [3.3, 0.4, math.pi / 2 - 0.21]])
    assert metres == pytest.approx([0.0, 0.5])
    assert radians == pytest.approx([0.01, 0.2])


@given(frame=poses, error=st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1)))
def test_the_frame_does_not_matter_and_the_error_is_what_was_added(frame, error):
    edges = np.array([[0, 3], [2, 1], [3, 2]])
    measured = between(TRUTH[edges[:, 0]], TRUTH[edges[:, 1]]) + error
    metres, radians = closure_errors(compose(np.array(frame), TRUTH), edges, measured)
    assert metres == pytest.approx(np.full(3, math.hypot(error[0], error[1])), abs=1e-9)
    assert radians == pytest.approx(np.full(3, abs(error[2])), abs=1e-9)


def test_false_is_more_than_half_a_metre_or_five_degrees():
    edges = np.tile([0, 1], (5, 1))
    off = [(0, 0, 0), (0.29, 0.4, 0), (0.31, 0.4, 0), (0, 0, math.radians(-4.9)), (0.1, 0, math.radians(5.1))]
    measured = TRUTH[1] + np.array(off)
    assert false_closures(TRUTH, edges, measured).tolist() == [False, False, True, False, True]


@pytest.mark.parametrize("turn", [0.0, 0.7, math.pi / 2])
def test_along_an_open_direction_nothing_is_false(turn):
    """A corridor along x of the frame in which the measurement begins; the information is of the one where it ends."""
    c, s = math.cos(turn), math.sin(turn)
    across = np.array([s, c])  # the corridor's y axis, seen turned by `turn`
    information = np.zeros((1, 3, 3))
    information[0, :2, :2] = 1e3 * np.outer(across, across) + 1e-2 * np.eye(2)
    information[0, 2, 2] = 1e3
    truth = [[0.0, 0.0, 0.0], [3.0, 1.0, turn]]
    for along, off in ((7.0, 0.0), (0.0, 0.4), (-7.0, -0.6)):
        metres, _ = closure_errors(truth, [[0, 1]], [[3.0 + along, 1.0 + off, turn]], information)
        assert metres == pytest.approx([abs(off)], abs=1e-9)
        told = false_closures(truth, [[0, 1]], [[3.0 + along, 1.0 + off, turn]], information)
        assert told.tolist() == [abs(off) > 0.5]
    assert closure_errors(truth, [[0, 1]], [[10.0, 1.0, turn]])[0] == pytest.approx([7.0])


def scan_over(ranges, bearings, **limits) -> LaserScan:
    return LaserScan.from_ranges(0, ranges, ScanGeometry(bearings), **limits)


def turn(beams: int) -> np.ndarray:
    return np.linspace(-math.pi, math.pi, beams, endpoint=False)


@pytest.mark.parametrize("beams", [1081, 4000, 100_000])
@pytest.mark.parametrize("direction", [1, -1])
def test_of_a_dense_scan_beams_are_taken_at_equal_steps_of_arc(beams, direction):
    """Half of them at 2 m, half at 8 m: by bearing there were as many of both, by arc there are four times as many."""
    bearings = turn(beams)[::direction]
    used = scan_over(np.where(np.abs(bearings) < math.pi / 2, 2.0, 8.0), bearings).beams(0.05, 30.0)
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
    scan = scan_over(rng.uniform(-1, 40, beams).astype(np.float32), bearings)
    every, used = scan.beams(0.05, 30.0, Thinning(1_000_000)), scan.beams(0.05, 30.0)
    assert used.indices[0] == every.indices[0]
    assert (np.diff(used.indices) > 0).all()
    kept = np.isin(every.indices, used.indices)
    np.testing.assert_array_equal(used.ends, every.ends[kept])


def test_widths_are_the_angles_between_neighbours():
    np.testing.assert_allclose(ScanGeometry(turn(8)).widths, math.pi / 4)
    np.testing.assert_allclose(ScanGeometry(turn(8)[::-1]).widths, math.pi / 4)
    np.testing.assert_allclose(ScanGeometry([0.0, 0.1, 0.3]).widths, [0.3, 0.1, 0.2], rtol=1e-12)
    assert ScanGeometry([1.0]).widths.tolist() == [0.0]
