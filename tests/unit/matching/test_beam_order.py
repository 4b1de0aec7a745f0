"""The order of beams, found from the scans of a turning robot that are deskewed in each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.matching.beam_order import BeamOrder
from gridslam.types import LaserScan, ScanGeometry

TIMES = np.array([0.0, 0.05, 0.1])


def order_of(swept, noise=0.0, count=60, loss=0.05):
    """Shares that fall with the square of how far a presumption is from the truth."""
    rng, order = np.random.default_rng(0), BeamOrder()
    for _ in range(count):
        shares = 0.9 - loss * np.square(np.array([1.0, 0.0, -1.0]) - swept) + rng.normal(0, noise, 3)
        order = order.add(*shares)
    return order


@given(st.floats(0.21, 3.0), st.sampled_from([-1, 1]))
def test_the_top_of_a_parabola_is_found(swept, sign):
    assert order_of(sign * swept).sweep_factor == pytest.approx(sign * swept, rel=1e-6)


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
    assert order == pytest.approx((1.0, 0.1, 0.2, 0.04))
    for ends, sign in zip(seen, (1, 0, -1), strict=True):
        np.testing.assert_array_equal(ends, beams.deskew(sign * fast).ends)
    assert order.learn(beams, np.array([0.2, 0.0, 0.19]), inlier_ratio) is order  # 0.019 rad in a scan
    untimed = LaserScan.from_ranges(0, np.full(3, 2.0), scan.geometry).beams(0.1, 29.0)
    assert order.learn(untimed, fast, inlier_ratio) is order
