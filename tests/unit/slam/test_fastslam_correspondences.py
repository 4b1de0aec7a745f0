"""FastSLAM where nothing tells the correspondences: what is drawn, what it weighs, and in which order."""

import numpy as np
import pytest

from gridslam.models.association import NEW, MaximumLikelihood
from gridslam.models.landmark import LandmarkObservations, RelativePosition
from gridslam.models.motion import GaussianIncrement
from gridslam.particles.policies import NeverResample
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.filters import LandmarkFilters, SampledPoses

STILL = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))


def test_correspondences_are_drawn_by_their_likelihood_and_weighed_by_its_sum():
    """Two landmarks, one nearer: the share of particles that take it is its share of p(z), known in closed form."""
    sensor = RelativePosition(sigma_x_m=0.2, sigma_y_m=0.2)
    slam = FastSlam1(LandmarkFilters(sensor, MaximumLikelihood()), when_to_resample=NeverResample())
    rng, count = np.random.default_rng(16), 4000
    state, _ = slam.step(slam.init(count), STILL, LandmarkObservations.of([[3.0, 0.6], [3.0, -0.6]]), rng)
    seen, nothing = LandmarkObservations.of([[3.0, 0.1]]), np.full((count, 1), NEW)
    columns, log_p, _ = slam.landmarks.correspond(state, seen, 0, SampledPoses(state.poses), nothing, rng)
    near, far = np.exp(-0.5 * np.array([0.5, 0.7]) ** 2 / 0.08) / (2 * np.pi * 0.08)  # S = 0.04 + 0.04 m^2
    new = np.exp(-0.5 * 25) / (2 * np.pi * 0.04)
    # A share p of 4,000 has a standard deviation of sqrt(p (1 - p) / 4000) < 0.008; five of them.
    assert np.mean(state.positions[np.arange(count), columns, 1] > 0) == pytest.approx(near / (near + far), abs=0.04)
    np.testing.assert_allclose(log_p, np.log(near + far + new), rtol=1e-9)
