from __future__ import annotations

import math

import checks
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ConfigurationError
from gridslam.geometry.se2 import transform_points
from gridslam.models import BeamRangeFinder, CauchyEndPoint, GMappingEndPoint, InverseSensorModel, LikelihoodField
from gridslam.types import LaserScan, ScanGeometry

MODELS = [BeamRangeFinder, CauchyEndPoint, GMappingEndPoint, LikelihoodField]
ROW = np.zeros(1, dtype=np.int64)
HERE = np.zeros((1, 3))


class Walls:
    """One infinite wall x = walls[row] in each map, with exact distances."""

    reach_m = 0.5

    def __init__(self, *walls: float) -> None:
        self.walls = np.array(walls)

    def distances(self, rows, poses, points):
        ends = np.stack([transform_points(pose, points) for pose in poses])
        return np.minimum(np.abs(ends[:, :, 0] - self.walls[rows, None]), self.reach_m).astype(np.float32)

    def cast_rays(self, rows, poses, origin, directions, max_m):
        start = np.stack([transform_points(pose, origin[None])[0] for pose in poses])
        headings = poses[:, 2, None] + np.arctan2(directions[:, 1], directions[:, 0])
        np.testing.assert_allclose(np.hypot(*directions.T), 1.0)
        towards = np.cos(headings)
        with np.errstate(divide="ignore"):
            ranges = (self.walls[rows] - start[:, 0])[:, None] / towards
        return np.where(ranges >= 0, np.minimum(ranges, max_m), max_m).astype(np.float32)


def beams_at(ranges, bearings, range_max_m=np.inf, mounting=(0.0, 0.0, 0.0)):
    geometry = ScanGeometry.planar(bearings, mounting)
    return LaserScan.from_ranges(0, ranges, geometry, range_max_m=range_max_m).beams(0.05, 30.0)


def value(model, beams, maps):
    return float(model(beams)(maps, ROW, HERE)[0])


@pytest.mark.parametrize("model", MODELS)
def test_the_true_pose_is_the_likeliest_and_each_pose_uses_its_own_map(model):
    bearings = np.radians([-40.0, -20.0, 0.0, 20.0, 40.0])
    mounting = (0.2, 0.0, 0.0)
    beams = beams_at(1.8 / np.cos(bearings), bearings, mounting=mounting)  # the wall is 2 m before the base
    x = np.linspace(-0.3, 0.3, 13)
    poses = np.stack([x, np.full(13, 5.0), np.zeros(13)], axis=1)
    weigh = model()(beams)
    got = weigh(Walls(2.0, 2.1), np.zeros(13, np.int64), poses)
    assert got.dtype == np.float64
    assert got.argmax() == 6
    assert weigh(Walls(2.0, 2.1), np.ones(13, np.int64), poses).argmax() == 8
    turned = weigh(Walls(2.0), ROW, np.array([[0.0, 0.0, 0.2]]))[0]
    assert turned < got[6]


# float32 distances carry a relative error of 6e-8, hence the tolerances of 1e-5.
@pytest.mark.parametrize("off", [0.0, 0.05, 0.1, 0.3])
def test_likelihood_field_value(off):
    model = LikelihoodField(z_hit=0.7, z_rand=0.2, z_max=0.1, sigma_hit_m=0.1, range_max_m=20, tempering=0.5)
    density = 0.7 * math.exp(-0.5 * (off / 0.1) ** 2) / (math.sqrt(2 * math.pi) * 0.1) + 0.2 / 20
    assert math.isclose(value(model, beams_at([2 - off] * 2, [0, 0]), Walls(2.0)), math.log(density), rel_tol=1e-5)


def test_cauchy_agreement_value():
    model = CauchyEndPoint(scale_m=0.1, tempering=0.5)
    # Agreements 1, 1/2 and 1/5 at distances of 0, 1 and 2 scales.
    assert math.isclose(value(model, beams_at([2.0, 1.9, 2.2], [0, 0, 0]), Walls(2.0)), 0.5 * 1.7, rel_tol=1e-5)


def test_end_point_value():
    model = GMappingEndPoint(scale_m2=0.075, miss_penalty_m2=0.5, kernel_m=0.075, likelihood_gain=2.0)
    # 5 cm off: 0.0025 / 0.075; 10 cm off is outside the window: 0.5 / 0.075.
    expected = -(0.0025 + 0.5) / 0.075 / 2
    assert math.isclose(value(model, beams_at([1.95, 1.9], [0, 0]), Walls(2.0)), expected, rel_tol=1e-5)


@given(
    expected=st.one_of(st.floats(0.05, 12), st.sampled_from([9.9, 10.0, 10.5, math.inf])), sigma=st.floats(0.02, 0.5)
)
def test_beam_densities_sum_to_one(expected, sigma):
    checks.beam_densities_sum_to_one(BeamRangeFinder.likelihoods, expected, sigma)


def test_beam_densities_by_hand():
    checks.beam_model(BeamRangeFinder.likelihoods)


def test_the_likelihood_field_in_closed_form():
    checks.likelihood_field(LikelihoodField.log_likelihoods)


# Pitched by 60 degrees the beam covers half its length on the ground: 4 m of it reach the wall at 2 m.
def test_a_tilted_laser_measures_slanted_ranges():
    mounting = np.eye(4)
    mounting[:3, :3] = [[0.5, 0, math.sqrt(0.75)], [0, 1, 0], [-math.sqrt(0.75), 0, 0.5]]
    tilted = LaserScan.from_ranges(0, [4.0], ScanGeometry([0.0], mounting)).beams(0.05, 30.0)
    density = BeamRangeFinder().likelihoods(np.float64(4.0), np.float64(4.0))
    assert math.isclose(value(BeamRangeFinder(), tilted, Walls(2.0)), math.log(density), rel_tol=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_a_scan_taken_while_turning_is_as_likely_as_one_taken_standing(model):
    """Half a turn before the wall x = 2, within which beams go past it: what hits and what does not, both deskewed."""
    directions, times = np.linspace(-1.6, 1.6, 81), np.linspace(0.0, 0.1, 81)
    ranges = np.where(np.abs(directions) < 1.3, 2 / np.cos(directions), 30.0)
    bearings = directions - 3.0 * times
    scans = [
        LaserScan.from_ranges(0, ranges, ScanGeometry(seen), range_max_m=30.0, beam_times_s=times)
        for seen in (bearings, directions)
    ]
    moved, still = (scan.beams(0.05, 30.0) for scan in scans)
    deskewed = value(model(), moved.deskew(np.array([0.0, 0.0, 3.0])), Walls(2.0))
    assert deskewed == pytest.approx(value(model(), still, Walls(2.0)), rel=1e-4)
    assert value(model(), moved, Walls(2.0)) < deskewed - 0.1


def test_tempering_scales_the_log_likelihood():
    beams = beams_at([1.9, 2.0], [0.0, 0.0])
    for model in (BeamRangeFinder, LikelihoodField, CauchyEndPoint):
        whole, tenth = (value(model(tempering=t), beams, Walls(2.0)) for t in (1.0, 0.1))
        assert math.isclose(tenth, 0.1 * whole, rel_tol=1e-12)


def bayes(prior: float, p_if_occupied: float, p_if_free: float) -> float:
    return p_if_occupied * prior / (p_if_occupied * prior + p_if_free * (1 - prior))


@given(
    true_occupied=st.floats(0.3, 0.95),
    false_occupied=st.floats(0.01, 0.25),
    prior=st.floats(0.05, 0.95),
    measurements=st.lists(st.booleans(), max_size=6),
)
def test_log_odds_are_bayes_rule_on_one_cell(true_occupied, false_occupied, prior, measurements):
    model = InverseSensorModel(true_occupied, 1 - true_occupied, false_occupied, 1 - false_occupied)
    belief, log_odds = prior, math.log(prior / (1 - prior))
    for occupied in measurements:
        if occupied:
            belief = bayes(belief, model.true_occupied, model.false_occupied)
            log_odds += model.log_odds_hit
        else:
            belief = bayes(belief, model.false_free, model.true_free)
            log_odds += model.log_odds_miss
    assert math.isclose(1 / (1 + math.exp(-log_odds)), belief, rel_tol=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"true_occupied": 0.7},
        {"true_free": 0.5},
        {"true_occupied": 0.1, "false_free": 0.9, "false_occupied": 0.2, "true_free": 0.8},
        {"true_occupied": 1.0, "false_free": 0.0},
        {"log_odds_min": 1.0},
        {"log_odds_occupied": 40.0},
        {"log_odds_occupied": -20.0},
        {"log_odds_max": math.inf},
        {"hit": 2.0},
    ],
)
def test_inconsistent_models_are_refused(wrong):
    with pytest.raises(ConfigurationError):
        InverseSensorModel(**wrong)
