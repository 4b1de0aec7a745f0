"""When beams are measured: as reported, or presumed from the period, in the order that is certain."""

import math

import numpy as np
import pytest

from gridslam.doctor.laser_motion import BeamTimes
from gridslam.matching.beam_order import BeamOrder
from gridslam.types import LaserScan, ScanGeometry

HALF_TURN = ScanGeometry(np.linspace(-math.pi / 2, math.pi / 2, 180, endpoint=False))


def scan(stamp_s, times=None):
    return LaserScan.from_ranges(round(1e9 * stamp_s), np.full(180, 2.0), HALF_TURN, beam_times_s=times)


def test_times_are_those_told_or_those_of_a_mirror_that_turns_once_a_scan():
    times, beams = BeamTimes(), np.array([0, 90, 179])
    assert times.of(scan(0.0), beams) is None
    for stamp_s in (0.0, 0.1, 0.2):
        times.update(scan(stamp_s))
    assert times.period_s == pytest.approx(0.1)
    np.testing.assert_allclose(np.diff(times.of(scan(0.3), beams)), 0.05 * np.diff(beams) / 180)
    told = np.linspace(0.03, 0.0, 180)
    np.testing.assert_allclose(np.diff(times.of(scan(0.3, told), beams)), np.diff(told[beams]))
    assert times.of(scan(0.3, told), beams).mean() == pytest.approx(0)


def order_of(swept):
    """Of 60 scans that agree with the map the less the farther a presumption is from the truth."""
    order = BeamOrder()
    for _ in range(60):
        order = order.add(*(0.9 - 0.05 * np.square(np.array([1.0, 0.0, -1.0]) - swept)))
    return order


@pytest.mark.parametrize(("swept", "sign"), [(0.0, None), (0.5, 1.0), (-0.5, -1.0)])
def test_scans_are_straightened_in_the_order_that_is_certain(swept, sign):
    times, seconds = BeamTimes(order_of(swept)), np.array([-0.1, 0.0, 0.1])
    straight = times.deskew_times(seconds)
    assert (straight is None) == (sign is None)
    if sign is not None:
        np.testing.assert_array_equal(straight, sign * seconds)
    assert times.deskew_times(None) is None
