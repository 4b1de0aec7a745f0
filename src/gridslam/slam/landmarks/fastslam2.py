"""FastSLAM 2.0: as FastSLAM 1.0, but the proposal includes the observations.

Where the motion is noisier than the sensor, most poses sampled from the motion model fit no observation, and their
particles are lost by resampling. Here the Gaussian of the motion is first corrected by the observations, as in an EKF,
for each particle with its own map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import require_generator, require_instance
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import lever_arm_jacobian
from gridslam.models.association import NEW
from gridslam.models.landmark import LandmarkObservations
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.particles import LandmarkParticles, PoseBelief
from gridslam.slam.landmarks.report import LandmarkReport
from gridslam.slam.landmarks.small_gaussians import draw_poses, kalman_update, transform_covariances
from gridslam.types import MotionSampler


@dataclass(frozen=True)
class FastSlam2(FastSlam1):
    """The filter: it has no state of its own; `step` takes a state and returns the next one.

    The pose is sampled from p(x_t | x_t-1, u_t, z_t, c_t), a Gaussian by linearizing the measurement model about the
    mean so far, one observation after the other. The weight is p(z_t | x_t-1, u_t, c_t), in which neither the sampled
    pose nor the landmarks that it then corrects have a part: what the proposal takes into account is not weighed again.

    Each observation conditions the proposal N(mu_x, Sigma_x): Sigma_x = [H_x' Q^-1 H_x + R^-1]^-1 = R - K H_x R and
    mu_x = x + Sigma_x H_x' Q^-1 (z - h) = x + K (z - h), with the Kalman gain K = R H_x' L^-1, which needs no inverse
    of R: that may be singular.

    Attributes
    ----------
    landmarks, resampler, when_to_resample
        As for `FastSlam1`.

    References
    ----------
    Probabilistic Robotics, Table 13.3; Montemerlo, Thrun, Koller, Wegbreit, FastSLAM 2.0, IJCAI 2003. The table
    has one observation in each step, draws a pose for each landmark it might be of and takes the one of greatest
    likelihood; here there are several, or none, and correspondences that are not known are judged by
    p(z_t | x_t-1, u_t, c_t), as in the paper. Without observations no pose is sampled yet, and the Gaussian of the
    motion is carried on. The table resamples at every step.
    """

    def init(self, particles: int = 20, pose: ArrayLike = (0.0, 0.0, 0.0)) -> LandmarkParticles:
        """Begin with all particles at one pose (3,), without landmarks."""
        return LandmarkParticles.at(particles, pose)

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
        proposal = self._predict(state, motion)  # predict pose: g(x_t-1, u_t), R_t
        mu_x, Sigma_x = proposal.poses, proposal.covariances
        log_weights = np.zeros(len(state))
        columns = np.full((len(state), len(observations)), NEW)
        if not len(observations):
            state.advance(proposal, log_weights)
            return state, state.report(columns)
        for k in self.landmarks.order(state, observations, proposal).tolist():
            # predict measurement: h, H_x, H_m, Q_j = H_m Sigma_j H_m' + Q_t, L = H_x R_t H_x' + Q_j; correspondence
            columns[:, k], log_p, seen = self.landmarks.correspond(state, observations, k, proposal, columns, rng)
            log_weights += log_p  # w = N(z; h, L), or p_0 for a new landmark
            # covariance and mean of proposal: Sigma_x = R - K H_x R, mu_x = x + K (z - h)
            kalman_update(mu_x, Sigma_x, seen.rows, seen.by_pose, seen.covariances, seen.residuals)
            mu_x[:, 2] = wrap(mu_x[:, 2])
        drawn = draw_poses(mu_x, Sigma_x, rng)  # sample pose: x_t ~ N(mu_x, Sigma_x)
        sampled = PoseBelief(drawn, np.zeros_like(Sigma_x))
        state.advance(sampled, log_weights)
        for k in range(len(observations)):  # update Kalman filters
            rows = np.flatnonzero(columns[:, k] >= 0)  # observed landmark: K = Sigma_j H_m' Q_j^-1
            seen = self.landmarks.innovation(state, rows, columns[rows, k], sampled, observations, k)
            self.landmarks.correct(state, seen)
            self.landmarks.add(state, columns[:, k], sampled, observations, k)  # new landmark: h^-1(z_t, x_t)
        return self.finish(state, columns, rng)

    def _predict(self, state: LandmarkParticles, motion: MotionSampler) -> PoseBelief:
        """p(x_t | x_t-1, u_t), of a pose x_t-1 that was sampled, or whose Gaussian was carried on."""
        poses, R = motion.moments(state.poses)
        G = lever_arm_jacobian(state.poses, poses)
        return PoseBelief(poses, R + transform_covariances(G, state.pose_covariances))
