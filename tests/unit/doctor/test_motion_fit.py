"""Laws of the robust fit and of the calibration, on drives whose laser is perfect."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.doctor.calibration import calibrate, robust_fit
from support.laser_drives import perfect


def test_deviations_hold_for_noise_of_unequal_and_correlated_terms():
    """z-scores over 200 draws: their mean square is 1 +- 4 sqrt(2/200) = 0.4 for exact deviations of normal errors."""
    rng, scores = np.random.default_rng(1), []
    for _ in range(200):
        x = rng.uniform(-1, 1, 300)
        white = rng.standard_normal(303)
        noise = (white[:-3] + white[1:-2] + white[2:-1]) * (1 + x**2)
        fit = robust_fit(x[:, None, None], (3 * x + noise)[:, None])
        scores.append((fit.parameters[0] - 3) / math.sqrt(fit.covariance[0, 0]))
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.45)


@settings(max_examples=15, deadline=None)
@given(
    scale=st.floats(0.8, 1.25),
    turn_scale=st.floats(0.9, 1.1),
    drift=st.floats(-0.05, 0.05),
    skew_s=st.floats(-0.6, 0.6),
    yaw=st.floats(-3.1, 3.1),
    x=st.floats(-0.3, 0.3),
    reflected=st.booleans(),
)
def test_what_went_in_comes_out(scale, turn_scale, drift, skew_s, yaw, x, reflected):
    """Without noise only interpolation between 10 Hz is left, cubic: 1e-3 of each."""
    motion = perfect(
        60.0,
        scale=scale,
        turn_scale=turn_scale,
        drift=drift,
        skew_s=skew_s,
        reflected=reflected,
        mounting=(x, 0.1, yaw),
        declared_yaw=0.5,
    )
    found = calibrate(motion)
    assert found.reflected == reflected
    assert found.skew_s.value == pytest.approx(skew_s, abs=2e-3)
    assert found.scale.value == pytest.approx(scale, rel=3e-3)
    assert found.turn_scale.value == pytest.approx(turn_scale, abs=4e-3)
    assert found.drift_rad_per_m.value == pytest.approx(drift, abs=3e-3)
    assert math.remainder(found.yaw_rad.value - yaw + 0.5, math.tau) == pytest.approx(0.0, abs=4e-3)


def test_deviations_of_the_calibration_hold():
    """z-scores of each estimate over 25 drives with a laser noise of 5 mm and 2 mrad, which is all the noise there is.

    Mean squares of 25 normal scores lie within 1 +- 4 sqrt(2/25) = 1.1 of 1; the scale's is smaller, as its deviation
    has a floor, and none is much below 1, lest the deviations be too timid.
    """
    rng, scores = np.random.default_rng(2), []
    for _ in range(25):
        found = calibrate(perfect(60.0, noise=(0.005, 0.002), rng=rng))
        scores.append(
            [
                (found.scale.value - 1) / found.scale.sigma,
                (found.turn_scale.value - 1) / found.turn_scale.sigma,
                found.drift_rad_per_m.value / found.drift_rad_per_m.sigma,
                found.yaw_rad.value / found.yaw_rad.sigma,
                found.skew_s.value / found.skew_s.sigma,
            ]
        )
    squares = np.square(scores).mean(axis=0)
    assert squares.max() < 2.1
    assert squares[1:].min() > 0.1


def test_turning_on_the_spot_determines_neither_scale_nor_yaw():
    rng = np.random.default_rng(3)
    motion = perfect(60.0, mounting=(0.0, 0.0, 0.0), declared_yaw=0.0, noise=(0.005, 0.002), rng=rng)
    still = np.array([0.0, 0.0, 1.0])
    found = calibrate(replace(motion, poses=motion.poses * still, odometry=motion.odometry * still))
    assert found.turn_scale.determined
    assert found.skew_s.determined
    assert not any(e.determined for e in (found.scale, found.yaw_rad, found.drift_rad_per_m))
