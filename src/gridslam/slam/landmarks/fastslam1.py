"""FastSLAM 1.0: a particle filter over paths, each particle with a small Kalman filter for each of its landmarks.

p(x_1:t, m | z_1:t, u_1:t) = p(x_1:t | z_1:t, u_1:t) prod_j p(m_j | x_1:t, z_1:t): given the path, landmarks are
independent.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import require_generator, require_instance
from gridslam.models.association import NEW
from gridslam.models.landmark import LandmarkObservations
from gridslam.particles.policies import EffectiveSampleSizeBelow, ResamplingPolicy
from gridslam.particles.resampling import Systematic
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.particles import LandmarkParticles, PoseBelief
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.types import IntArray, MotionSampler, Resampler


@dataclass(frozen=True)
class FastSlam1:
    """The filter: it has no state of its own; `step` takes a state and returns the next one.

    The pose is sampled from the motion model alone, so the weight is the likelihood of the observations.

    Attributes
    ----------
    landmarks : LandmarkFilters
        Measurement model, data association and existence of landmarks.
    resampler : Resampler
        Which particles survive.
    when_to_resample : ResamplingPolicy
        When resampling is worth its loss of diversity.

    References
    ----------
    Probabilistic Robotics, Tables 13.1 (known correspondences) and 13.2 (unknown); Montemerlo, Thrun, Koller,
    Wegbreit, FastSLAM, AAAI 2002. The tables resample at every step.
    """

    landmarks: LandmarkFilters = field(default_factory=LandmarkFilters)
    resampler: Resampler = Systematic()
    when_to_resample: ResamplingPolicy = EffectiveSampleSizeBelow()

    def init(self, particles: int = 100, pose: ArrayLike = (0.0, 0.0, 0.0)) -> LandmarkParticles:
        """Begin with all particles at one pose (3,), without landmarks."""
        return LandmarkParticles.at(particles, pose)

    def step(
        self,
        state: LandmarkParticles,
        motion: MotionSampler,
        observations: LandmarkObservations,
        rng: np.random.Generator,
    ) -> tuple[LandmarkParticles, LandmarkReport]:
        """Take one step; consumes `state` (keep one for later with `state.snapshot()`).

        Parameters
        ----------
        state : LandmarkParticles
        motion : MotionSampler
            The motion model, conditioned on u_t.
        observations : LandmarkObservations
            z_t, with c_t where the association needs it; perhaps none.
        rng : numpy.random.Generator

        Raises
        ------
        ArgumentError
            The association needs correspondences that the observations do not contain.
        """
        require_instance("state", state, LandmarkParticles)
        require_generator(rng)
        state = state.take()
        poses = motion(state.poses, rng)  # sample pose: x_t ~ p(x_t | x_t-1, u_t)
        sampled = PoseBelief(poses, np.zeros_like(state.pose_covariances))
        log_weights = np.zeros(len(state))
        columns = np.full((len(state), len(observations)), NEW)
        for k in self.landmarks.order(state, observations, sampled).tolist():
            columns[:, k], log_p, seen = self.landmarks.correspond(state, observations, k, sampled, columns, rng)
            log_weights += log_p  # w = N(z; h, Q), with Q = H_m Sigma_j H_m' + Q_t, or p_0 for a new landmark
            self.landmarks.correct(state, seen)  # observed landmark: K = Sigma_j H_m' Q^-1
        for k in range(len(observations)):
            self.landmarks.add(state, columns[:, k], sampled, observations, k)  # new landmark: h^-1(z_t, x_t)
        state.advance(sampled, log_weights)
        return self.finish(state, columns, rng)

    def finish(
        self, state: LandmarkParticles, columns: IntArray, rng: np.random.Generator
    ) -> tuple[LandmarkParticles, LandmarkReport]:
        """End a step: count the landmarks `columns` (N, K) that were observed, report, and resample."""
        self.landmarks.count(state, columns)  # the counters i_j, of landmarks that should have been seen, too
        report = state.report(columns)
        if self.when_to_resample(report.n_eff, len(state), len(state)):
            drawn = self.resampler(np.exp(state.log_weights), len(state), rng)
            report = replace(report, parents=state.resample(drawn))
        return state, report

    def landmark_map(self, state: LandmarkParticles) -> LandmarkMap:
        """Return the confirmed landmarks of the best particle."""
        return state.landmark_map()
