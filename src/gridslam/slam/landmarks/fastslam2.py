"""FastSLAM 2.0: as FastSLAM 1.0, but the proposal includes the observations.

Where the motion is noisier than the sensor, most poses sampled from the motion model fit no observation, and their
particles are lost by resampling. Here the Gaussian of the motion is first corrected by the observations, as in an EKF,
for each particle with its own map.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import require_generator, require_instance
from gridslam.models.association import NEW
from gridslam.models.landmark_observations import LandmarkObservations
from gridslam.models.odometry_bias import EXACT_ODOMETRY, OdometryBias
from gridslam.particles.policies import EffectiveSampleSizeBelow, ResamplingPolicy
from gridslam.particles.resampling import Systematic
from gridslam.slam.landmarks.bias import predict
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.local_frame import LocalFrameBelief
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.types import MotionSampler, Resampler

__all__ = ["FastSlam2"]


@final
@dataclass(frozen=True)
class FastSlam2:
    """The filter; what it knows is in the state that goes in and comes out of `step`.

    The pose is sampled from p(x_t | x_t-1, u_t, z_t, c_t), a Gaussian by linearizing the measurement model about the
    mean so far, one observation after the other. Without observations no pose is sampled, and the Gaussian is
    propagated. The weight is p(z_t | x_t-1, u_t, c_t), in which neither the sampled pose nor the landmarks that it then
    corrects have a part: what the proposal takes into account is not weighed again.

    Where only new landmarks are observed, the pose is not sampled either: the new landmarks are kept in a local frame
    whose pose is Gaussian (see `gridslam.slam.landmarks.local_frame`). So particles are not depleted by what is not
    observable yet.

    Attributes
    ----------
    landmarks, resampler, when_to_resample
        As for `FastSlam1`.
    bias : OdometryBias
        Systematic errors of the odometry, of which each particle keeps a Gaussian: they are never sampled, nor is the
        part of the pose and of the landmarks that depends linearly on them. So a loop closure corrects the whole
        trajectory before it. As the errors change, all is expressed by their current values (see
        `landmark_bias.predict`).

    Source: Probabilistic Robotics, Table 13.3; Montemerlo, Thrun, Koller, Wegbreit, FastSLAM 2.0, IJCAI 2003. The
    correspondence is the one of greatest p(z_t | x_t-1, u_t, c_t), as in the paper, where the table draws a pose for
    each landmark and compares their likelihoods; and the tables resample at every step and draw every pose.
    """

    landmarks: LandmarkFilters = field(default_factory=LandmarkFilters)
    resampler: Resampler = Systematic()
    when_to_resample: ResamplingPolicy = EffectiveSampleSizeBelow()
    bias: OdometryBias = EXACT_ODOMETRY

    def init(self, particles: int = 20, pose: ArrayLike = (0.0, 0.0, 0.0)) -> LandmarkParticles:
        """Begin with all particles at one pose (3,), without landmarks."""
        return LandmarkParticles.at(particles, pose, self.bias.covariance())

    def step(
        self,
        state: LandmarkParticles,
        motion: MotionSampler,
        observations: LandmarkObservations,
        rng: np.random.Generator,
    ) -> tuple[LandmarkParticles, LandmarkReport]:
        """Take one step; consumes `state`. Parameters and exceptions are those of `FastSlam1.step`."""
        require_instance("state", state, LandmarkParticles)
        require_generator(rng)
        state = state.take()
        mean, spread = predict(state, self.bias, motion, rng)  # of p(x_t, b_t | x_t-1, u_t)
        if not len(observations):
            state.predict_without_drawing(mean, spread)
            return state, state.report(np.empty((len(state), 0), np.int64))
        log_weights, columns = np.zeros(len(state)), np.full((len(state), len(observations)), NEW)
        belief = LocalFrameBelief.of(state, mean, spread)
        for k in self.landmarks.order(state, observations, belief.poses).tolist():
            columns[:, k], log_p, seen = self.landmarks.correspond(
                state, observations, k, belief.poses, belief, columns, rng
            )
            log_weights += log_p  # w = p(z | x_t-1, u_t)
            belief.correct(seen)
        unknown = np.flatnonzero((columns == NEW).all(axis=1))
        belief.open_local_frame(
            unknown[self.landmarks.is_less_certain(belief.poses[unknown], spread[unknown], observations)], rng
        )
        state.advance(*belief.draw(rng), log_weights, belief.replaced)  # x_t ~ p(x_t | x_t-1, u_t, z_t)
        for k in range(len(observations)):
            rows = np.flatnonzero(columns[:, k] >= 0)
            apart = belief.cross_frame_covariance(rows, columns[rows, k])
            seen = self.landmarks.innovation(state, rows, columns[rows, k], state.poses, apart, observations, k)
            self.landmarks.correct(state, seen)
            self.landmarks.add(state, columns[:, k], state.poses, observations, k)
        self.landmarks.count(state, columns)
        report = state.report(columns)
        if self.when_to_resample(report.n_eff, len(state)):
            drawn = self.resampler(np.exp(state.log_weights), len(state), rng)
            report = replace(report, parents=state.resample(drawn))
        return state, report

    def landmark_map(self, state: LandmarkParticles) -> LandmarkMap:
        """Return the confirmed landmarks of the best particle."""
        return state.landmark_map()
