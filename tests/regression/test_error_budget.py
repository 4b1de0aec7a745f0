"""Each stage is as exact as the page on scan matching states, against exact truth and beside the bound of the beams."""

from __future__ import annotations

import pytest

from error_budget import judge

TARGETS = {("rooms", 301): (0.006, 0.06), ("random", 303): (0.006, 0.06)}
"""ATE of the final trajectory, m and degrees, by world and seed. In the building of seed 303 the cells of a map agree
better with the poses that the filter fitted to them (0.012 m off) than with the adjusted ones."""


@pytest.fixture(scope="module", params=TARGETS)
def budget(request):
    return request.param, judge(*request.param)


def test_the_final_trajectory_is_exact(budget):
    case, stages = budget
    ate_m, ate_deg, rpe_m, _ = stages["final"]
    assert stages["bound"][0] < ate_m < TARGETS[case][0]
    assert ate_deg < TARGETS[case][1]
    assert rpe_m < 0.006


def test_surfaces_make_the_tracker_twice_as_exact(budget):
    """Without them, as one sees, it would not be."""
    _, stages = budget
    assert stages["bound"][2] < stages["tracker"][2] < 0.5 * stages["tracker, cells"][2]
    assert stages["tracker"][3] < 0.5 * stages["tracker, cells"][3]


def test_the_online_trajectory_is_smooth(budget):
    """Twice as smooth as the matches to cells that it follows, which were reported before: 0.009 to 0.011 m."""
    _, stages = budget
    assert stages["online"][2] < 0.4 * stages["odometry"][2]
    assert stages["online"][2] < 0.008
    assert stages["online"][3] < 0.12


def test_a_corridor_is_as_long_as_it_is():
    """Lines at the end of a scan, matched with points beyond it, shorten it by 0.3 %: 0.13 m of ATE after 75 m."""
    final = judge("corridor", 7)["final"]
    assert final[0] < 0.02
    assert final[2] < 0.01
