"""As many particles as the belief needs: the bins of KLD-sampling, the bounds, and what a filter makes of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import build, preset
from gridslam.models import DiffusionMotion
from gridslam.particles import kld_bound
from gridslam.particles.kld_sampling import count_needed
from gridslam.slam import GridFastSlam, MotionModelProposal, OdometryTracker

ABOUT = np.array([40.0, -7.0, math.pi - 0.01])


def test_one_hypothesis_needs_none_beside_it_and_each_bin_more_asks_for_more():
    rng = np.random.default_rng(0)
    close = ABOUT + rng.uniform(-1, 1, (500, 3)) * [0.24, 0.24, math.radians(4.9)]
    assert count_needed(close, ABOUT) == 0
    for bins in (2, 3, 5, 20):
        apart = np.repeat(ABOUT[None], bins, axis=0)
        apart[:, 0] += 0.5 * np.arange(bins)
        assert count_needed(np.concatenate([close, apart]), ABOUT) == kld_bound(np.array(bins), 0.2, 2.33)


def test_headings_are_compared_around_the_circle():
    both_sides = ABOUT + np.array([[0, 0, 0.0], [0, 0, 0.02 - math.tau]])
    assert count_needed(both_sides, ABOUT) == 0
    assert count_needed(ABOUT + np.array([[0, 0, 0.0], [0, 0, 0.2]]), ABOUT) == 17


def counts(slam, measurements, play, particles):
    state, reports = play(slam, measurements, particles=particles)
    assert state.particles_max == particles
    return [len(report.poses) for report in reports if report.skipped is None]


def test_where_all_agree_few_are_left_and_a_fixed_number_stays(drive, play):
    slam = GridFastSlam()
    assert set(counts(slam, drive.measurements[:80], play, 30)[2:]) == {8}
    assert set(counts(slam, drive.measurements[:80], play, 5)) == {5}, "fewer than the least: all stay"
    assert set(counts(replace(slam, particles_min=30), drive.measurements[:80], play, 30)) == {30}


def test_gmapping_has_a_fixed_number(drive, play):
    """Of 200, which its noisy motion alone would not keep."""
    assert set(counts(build(preset("gmapping")), drive.measurements[:60], play, 200)) == {200}


def test_where_scans_are_far_apart_none_is_left_out(drive, play):
    """Their next draw must hold the place; at first, and with a scan every 0.2 s, few are enough."""
    numbers = counts(GridFastSlam(), [*drive.measurements[:20], *drive.measurements[20::6]], play, 30)
    assert min(numbers) == 8
    assert set(numbers[-5:]) == {30}


@pytest.mark.parametrize("most", [20, 30])
def test_where_they_spread_they_grow_in_number_to_as_many_as_began(drive, play, most):
    """Particles that nothing matches spread as the motion does."""
    slam = GridFastSlam(tracker=OdometryTracker(), motion=DiffusionMotion(0.05, 0.05), proposal=MotionModelProposal())
    numbers = counts(slam, drive.measurements, play, most)
    assert numbers[:2] == [most, most]
    assert min(numbers) < most
    assert max(numbers[3:]) == most
