"""FastSLAM 2.0 that learns the systematic errors of the odometry, as a Gaussian in each particle.

These errors are never sampled, nor is the part of the pose and of the landmarks that depends linearly on them. So a
loop closure corrects the whole trajectory before it. As the errors change, all is expressed by their current values.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.geometry.angles import wrap
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.slam.landmarks.fastslam2 import FastSlam2, PoseProposal
from gridslam.slam.landmarks.filters import Innovation, SampledPoses
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.slam.landmarks.small_gaussians import draw, draw_poses, matvec, transform_covariances, transpose
from gridslam.types import FloatArray, IntArray, MotionSampler

_FAR_M = 10.0  # greatest range for which the scale of ranges matters to the bound of a gate
_ROUNDING = 1e-12  # of a variance: where less than that is left, its correlations are nonsense


@final
@dataclass(frozen=True)
class FastSlam2WithCalibration(FastSlam2):
    """FastSLAM 2.0 whose particles learn the odometry's errors b.

    Attributes
    ----------
    landmarks, resampler, when_to_resample
        As for `FastSlam2`.
    bias : SystematicErrors
        The errors that are learned.
    """

    bias: SystematicErrors = field(default_factory=SystematicErrors)

    def __post_init__(self) -> None:
        """The landmarks of the particles depend on the errors of the sensor."""
        object.__setattr__(self, "landmarks", replace(self.landmarks, bias=self.bias))

    def init(self, particles: int = 20, pose: ArrayLike = (0.0, 0.0, 0.0)) -> LandmarkParticles:
        """Begin with all particles at one pose (3,), without landmarks, and with errors of which nothing is known."""
        return LandmarkParticles.at(particles, pose, self.bias.covariance())

    def _predict(
        self, state: LandmarkParticles, motion: MotionSampler, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Predict where the particles are, and how the odometry errs from now on.

        Pose and landmarks lean on the errors b that were. Of those, b = c + G b' of the errors b' that are now and a
        rest that is independent of b'. The rest is drawn, so that all comes to lean on b' alone: by the derivatives
        times G.
        """
        mean, F, Q = self.bias.predict(motion, state.state_means)
        covariance = Q + transform_covariances(F, state.state_covariances)
        back = state.state_covariances[:, 3:, 3:] @ np.linalg.inv(covariance[:, 3:, 3:])
        rest = back @ Q[:, 3:, 3:]
        rest = (rest + transpose(rest)) / 2
        G = back @ F[:, 3:, 3:]
        drawn = draw(np.zeros((len(state), len(self.bias))), rest, rng)
        by_bias = F[:, :3, :3] @ state.pose_by_bias + F[:, :3, 3:]
        mean[:, :3] += matvec(by_bias, drawn)
        mean[:, 2] = wrap(mean[:, 2])
        covariance[:, :3, :3] -= transform_covariances(by_bias, rest)
        leaning = state.positions_by_bias.reshape(len(state), -1, len(self.bias))  # few large products: faster
        state.positions += (leaning @ drawn[:, :, None]).reshape(state.positions.shape)
        state.positions_by_bias = (leaning @ G).reshape(state.positions_by_bias.shape)
        state.bias_before[..., 0] = state.state_means[:, 3:] - matvec(G, mean[:, 3:]) + drawn
        state.bias_before[..., 1:] = G
        return mean, covariance

    def _propose(self, state: LandmarkParticles, mean: FloatArray, covariance: FloatArray) -> PoseProposal:
        return BiasProposal(mean, covariance, state, self.bias)


@final
@dataclass(eq=False)
class BiasProposal(PoseProposal):
    """Joint Gaussian of the pose and of the odometry's errors b of each particle within one step.

    With the error e of the pose and errors b that move a landmark by A b, an observation of it depends on e - A b.

    Attributes
    ----------
    mean, covariance : (N, 3 + B), (N, 3 + B, 3 + B) float64
        Of the poses, map frame, and b; of e and b.
    state : LandmarkParticles
        Its landmarks move as the errors are corrected.
    """

    state: LandmarkParticles
    bias: SystematicErrors

    @property
    def calibration(self) -> FloatArray:
        """Mounting and scale (N, 2) of the sensor, as each particle has learned them."""
        return self.bias.calibration(self.mean[:, 3:])

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Covariance (R, 3, 3) of the poses as seen from landmarks (rows, columns)."""
        return transform_covariances(self._errors_seen_from(rows, columns), self.covariance[rows])

    def bound_covariance(self) -> FloatArray:
        """Upper bound (N, 3, 3) of the pose covariance relative to any landmark."""
        turned = transform_covariances(self.state.positions_by_bias, self.covariance[:, None, 3:, 3:])
        most = np.trace(turned, axis1=2, axis2=3).max(axis=1, initial=0.0)
        of_sensor = self.bias.by_calibration(np.broadcast_to(np.diag([1.0, _FAR_M]), (1, 2, 2)))
        most += np.trace(transform_covariances(of_sensor, self.covariance[:, 3:, 3:]), axis1=1, axis2=2)
        return np.asarray(2 * (self.covariance[:, :3, :3] + most[:, None, None] * np.diag([1.0, 1.0, 0.0])))

    def correct(self, seen: Innovation) -> FloatArray:
        """Condition on an observation; all landmarks move as they depend on the errors."""
        shift = super().correct(seen)
        self.state.positions[seen.rows] += (self.state.positions_by_bias[seen.rows] @ shift[:, None, 3:, None])[..., 0]
        return shift

    def sample(self, rng: np.random.Generator) -> SampledPoses:
        """Sample the part of the poses that is independent of the errors; return the covariances that remain."""
        left = (self.covariance + transpose(self.covariance)) / 2  # what is never drawn adds up its rounding, too
        whole = left[:, :3, :3].copy()
        shared = left[:, :3, 3:]
        left[:, :3, :3] = shared @ np.linalg.inv(left[:, 3:, 3:]) @ transpose(shared)
        own = whole - left[:, :3, :3] + _ROUNDING * np.eye(3) * whole
        self.mean[:, :3] = draw_poses(self.mean[:, :3], own, rng)
        self.covariance = left
        return SampledPoses(self.poses, self.calibration)

    def _jacobian(self, seen: Innovation) -> FloatArray:
        return seen.by_pose @ self._errors_seen_from(seen.rows, seen.columns)

    def _errors_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Jacobians (R, 3, 3 + B) of the poses' errors as seen from landmarks (rows, columns)."""
        errors = np.zeros((len(rows), 3, self.covariance.shape[1]))
        errors[:, :, :3] = np.eye(3)
        errors[:, :2, 3:] = -self.state.positions_by_bias[rows, columns]
        # a sensor that is mounted ahead is as a robot that is ahead, and too long a range as one that is behind
        theta = self.mean[rows, 2]
        ahead = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        mounted, scale = np.split(self.calibration[rows], 2, axis=1)
        relative = self.state.positions[rows, columns] - self.mean[rows, :2] - mounted * ahead
        errors[:, :2, 3:] += self.bias.by_calibration(np.stack([ahead, -relative / (1.0 + scale)], axis=-1))
        return errors
