"""Ray casting against distances worked out by hand and against all pairs of beam and wall; the sensor's noise."""

import math

import numpy as np
import pytest

from gridslam.sim.floor_plan import box, join, polyline
from gridslam.sim.lidar import LidarConfig, cast_rays, disc_ranges, measure


def _all_pairs(walls, laser, bearings):
    """First intersections by solving every pair of beam and wall as two linear equations."""
    ranges = np.full(len(bearings), np.inf)
    for beam, bearing in enumerate(bearings):
        direction = np.array([math.cos(laser[2] + bearing), math.sin(laser[2] + bearing)])
        for x0, y0, x1, y1 in walls:
            matrix = np.array([[direction[0], x0 - x1], [direction[1], y0 - y1]])
            reach, along = np.linalg.solve(matrix, [x0 - laser[0], y0 - laser[1]])
            if reach > 0 and 0 <= along <= 1:
                ranges[beam] = min(ranges[beam], reach)
    return ranges


def test_ranges_in_a_room_by_hand():
    bearings = np.array([-math.pi / 2, 0.0, math.pi / 6, math.pi / 2, math.pi - 1e-6])
    ranges = cast_rays(box(0, 0, 10, 8), np.array([[4.0, 3.0, 0.0]]), bearings)
    assert ranges[0] == pytest.approx([3.0, 6.0, 6.0 / math.cos(math.pi / 6), 5.0, 4.0], rel=1e-11)


@pytest.mark.parametrize("turn", range(8))
def test_no_beam_slips_through_a_corner_where_two_walls_meet(turn):
    corners = np.array([math.pi / 4, 3 * math.pi / 4, 5 * math.pi / 4, 7 * math.pi / 4])
    heading = turn * math.pi / 4
    bearings = np.sort(np.mod(corners - heading, math.tau))
    ranges = cast_rays(box(-2, -2, 2, 2), np.array([[0.0, 0.0, heading]]), bearings)
    assert ranges == pytest.approx(np.full((1, 4), 2 * math.sqrt(2)))


def test_nothing_to_hit_is_infinite_and_so_is_a_wall_seen_end_on():
    bearings = np.array([-0.5, 0.0, 0.5])
    assert np.isinf(cast_rays(join(), np.zeros((2, 3)), bearings)).all()
    assert np.isinf(cast_rays(polyline([(2, 0), (3, 0)]), np.zeros((1, 3)), bearings)).all()
    assert np.isinf(cast_rays(polyline([(-2, -1), (-2, 1)]), np.zeros((1, 3)), bearings)).all()


@pytest.mark.parametrize("field_of_view", [1.0, math.pi, math.tau])
def test_agrees_with_all_pairs_of_beam_and_wall(field_of_view):
    rng = np.random.default_rng(1)
    walls = rng.uniform(-5, 5, (40, 4))
    lasers = rng.uniform((-6, -6, -10), (6, 6, 10), (12, 3))
    bearings = LidarConfig(beams=90, field_of_view_rad=field_of_view).bearings
    ranges = cast_rays(walls, lasers, bearings)
    expected = np.array([_all_pairs(walls, laser, bearings) for laser in lasers])
    assert np.isinf(expected).any()
    np.testing.assert_allclose(ranges, expected, rtol=1e-9)


def test_many_scans_are_cast_as_each_alone():
    rng = np.random.default_rng(2)
    walls = rng.uniform(-5, 5, (300, 4))
    lasers = rng.uniform(-5, 5, (1000, 3))
    bearings = LidarConfig(beams=20).bearings
    together = cast_rays(walls, lasers, bearings)
    for k in (0, 436, 437, 999):
        assert together[k].tobytes() == cast_rays(walls, lasers[k : k + 1], bearings).tobytes()


def test_disc_in_the_way_by_hand():
    lasers = np.array([[1.0, 2.0, math.pi / 2]])
    centres = np.array([[[1.0, 6.0], [1.0, 9.0]]])
    ranges = disc_ranges(centres, 0.5, lasers[:, None], np.array([-1.0, 0.0, 0.1]))
    touch = 4 * math.cos(0.1) - math.sqrt(0.25 - (4 * math.sin(0.1)) ** 2)
    assert ranges == pytest.approx(np.array([[np.inf, 3.5, touch]]))


def test_bearings_follow_the_rule_of_carmen_logs():
    step = math.pi / 180
    assert LidarConfig(beams=180).bearings == pytest.approx(np.arange(-90, 90) * step)
    assert LidarConfig(beams=181).bearings == pytest.approx(np.arange(-90, 91) * step)
    full = LidarConfig(beams=5, field_of_view_rad=math.tau).bearings
    assert full == pytest.approx(np.deg2rad([-180, -108, -36, 36, 108]))


@pytest.mark.parametrize(("said", "value"), [("max", 8.0), ("inf", np.inf), ("nan", np.nan), ("zero", 0.0)])
def test_what_is_reported_where_nothing_returns(said, value):
    lidar = LidarConfig(range_max_m=8.0, no_return=said, no_return_probability=0.5)
    measured = measure(np.array([[9.0] * 3 + [4.0] * 50]), lidar, np.random.default_rng(0))[0]
    nothing = np.isclose(measured, value, equal_nan=True)
    assert nothing[:3].all()
    assert 10 < nothing.sum() < 45
    assert measured[~nothing] == pytest.approx(np.full((~nothing).sum(), 4.0), abs=0.1)


def test_noise_and_losses_are_as_configured():
    lidar = LidarConfig(sigma_range_m=0.02, no_return_probability=0.1, range_max_m=20.0)
    count = 100_000
    measured = measure(np.full((100, 1000), 5.0), lidar, np.random.default_rng(3))
    lost = measured == 20.0
    # Five standard deviations of a binomial share, of a mean and of a standard deviation.
    assert lost.mean() == pytest.approx(0.1, abs=5 * math.sqrt(0.1 * 0.9 / count))
    kept = measured[~lost]
    assert kept.mean() == pytest.approx(5.0, abs=5 * 0.02 / math.sqrt(len(kept)))
    assert kept.std() == pytest.approx(0.02, rel=5 / math.sqrt(2 * len(kept)))
