"""FastSLAM 2.0 with a local frame in each particle: for landmarks first observed from an uncertain pose.

After an interval without observations the pose is uncertain by decimetres, and landmarks that are then observed for the
first time have the same error. Sampling that pose would fix all of them: particles with other samples are lost by
resampling long before the robot observes known landmarks again. So it is not sampled. The new landmarks are kept in a
local frame, and the pose of this frame is a Gaussian that is corrected by a Kalman update whenever landmarks of both
frames are observed. The remaining pose is sampled: in the local frame or in the map frame, whichever holds the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose, inverse, lever_arm_jacobian, transform_points
from gridslam.models.association import NEW
from gridslam.models.landmark import LandmarkObservations
from gridslam.slam.landmarks.fastslam2 import FastSlam2, PoseProposal
from gridslam.slam.landmarks.filters import Innovation, SampledPoses
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.slam.landmarks.small_gaussians import draw_poses, matvec, transform_covariances, transpose
from gridslam.types import FloatArray, IntArray

__all__ = ["FastSlam2WithLocalFrames", "LocalFrameProposal"]

_EXACT = 1e-6  # m^2 and rad^2: what is known to 1 mm and 1 mrad is not known better by less


@final
@dataclass(frozen=True)
class FastSlam2WithLocalFrames(FastSlam2):
    """FastSLAM 2.0 that samples no pose where only new landmarks are observed: they go into a local frame.

    So particles are not depleted by what is not observable yet. Attributes are those of `FastSlam2`.
    """

    def _propose(self, state: LandmarkParticles, mean: FloatArray, covariance: FloatArray) -> PoseProposal:
        proposal = LocalFrameProposal(mean, covariance, state)
        if state.local_frame_covariances.any():
            proposal.append(state.local_frame_covariances)
        return proposal

    def _sample(
        self, proposal: PoseProposal, observations: LandmarkObservations, columns: IntArray, rng: np.random.Generator
    ) -> SampledPoses:
        assert isinstance(proposal, LocalFrameProposal)
        only_new = np.flatnonzero((columns == NEW).all(axis=1))
        poses = proposal.mean[only_new]
        _, H_x, _ = self.landmarks.sensor.linearize(poses, self.landmarks.sensor.locate(poses, observations.values[0]))
        of_pose = transform_covariances(H_x, np.ascontiguousarray(proposal.covariance[only_new, :3, :3]))
        ratio = np.linalg.inv(self.landmarks.sensor.noise(observations)[0]) @ of_pose
        less_certain = np.trace(ratio, axis1=1, axis2=2) > 2.0  # the pose than the observation, of two numbers
        proposal.open_local_frames(only_new[less_certain], rng)
        return proposal.sample(rng)


@final
@dataclass(eq=False)
class LocalFrameProposal(PoseProposal):
    """Joint Gaussian of the pose and of the local frame of each particle within one step.

    With the error e of the pose and the error d of the local frame, the pose errs by e + s L d, where s is 1 if the
    robot is in the local frame and 0 otherwise, and L is the lever. An observation of a landmark in the frame of the
    robot depends on e only; otherwise on e + (s - f) L d, where f is 1 for landmarks in the local frame.

    Attributes
    ----------
    mean : (N, 3) float64
        Poses, map frame.
    covariance : (N, 3, 3) or (N, 6, 6) float64
        Of e, or of e and d if any particle has a local frame.
    state : LandmarkParticles
        Its local frames and the landmarks in them move as they are corrected.
    """

    state: LandmarkParticles

    @property
    def has_local_frames(self) -> bool:
        """Whether any particle has a local frame."""
        return bool(self.covariance.shape[1] > 3)

    def append(self, of_local_frames: FloatArray | float) -> None:
        """Take covariances (N, 3, 3) of local frames in, independent of the poses."""
        self.covariance = np.pad(self.covariance, ((0, 0), (0, 3), (0, 3)))
        self.covariance[:, 3:, 3:] = of_local_frames

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Covariance (R, 3, 3) of the poses as seen from landmarks (rows, columns)."""
        if not self.has_local_frames:
            return super().covariance_seen_from(rows, columns)
        errors = self._errors(self.state.landmark_in_local_frame[rows, columns], rows)
        return transform_covariances(errors, self.covariance[rows])

    def bound_covariance(self) -> FloatArray:
        """Upper bound (N, 3, 3) of the pose covariance relative to any landmark."""
        if not self.has_local_frames:
            return super().bound_covariance()
        L = lever_arm_jacobian(self.state.local_frames, self.mean)
        # Of e +- L d, whose covariance between the two is at most what they have by themselves.
        return np.asarray(2 * (self.covariance[:, :3, :3] + transform_covariances(L, self.covariance[:, 3:, 3:])))

    def correct(self, seen: Innovation) -> FloatArray:
        """Condition on an observation; local frames move with all their landmarks."""
        shift = super().correct(seen)
        if self.has_local_frames:
            self._move(seen.rows, shift[:, 3:])
        return shift

    def open_local_frames(self, rows: IntArray, rng: np.random.Generator) -> None:
        """Open a local frame at the pose, with its covariance, in particles (R,) that observe only new landmarks.

        It replaces a less uncertain local frame, which is sampled: each particle has one.
        """
        own = self.covariance[rows, :3, :3]
        rows = rows[_volume(own) > _volume(self.state.local_frame_covariances[rows])]
        if not len(rows):
            return
        if self.has_local_frames:
            still = np.zeros((len(rows), 3))
            self._move(rows, draw_poses(still, self.covariance[rows, 3:, 3:], rng))
        else:
            self.append(0.0)
        self.covariance[rows, 3:, 3:] = self.covariance[rows, :3, :3]
        self.covariance[rows, :3, :3] = 0.0
        self.state.open_local_frames(rows, self.mean[rows])

    def sample(self, rng: np.random.Generator) -> SampledPoses:
        """Sample the poses in the frame with the smaller covariance and condition the local frame on them."""
        if not self.has_local_frames:
            return super().sample(rng)
        state = self.state
        seen_from = [self._errors(np.full(len(state), side)) for side in (False, True)]
        in_map, in_local = (transform_covariances(errors, self.covariance) for errors in seen_from)
        better = _volume(in_local) - _volume(in_map)
        in_local_frame = (better < 0) | (state.in_local_frame & (better == 0))
        own, errors = (np.where(in_local_frame[:, None, None], b, a) for a, b in ((in_map, in_local), seen_from))
        poses = draw_poses(self.mean, own, rng)
        drawn = poses - self.mean
        drawn[:, 2] = wrap(drawn[:, 2])
        shared = self.covariance[:, 3:] @ transpose(errors)
        gain = shared @ np.linalg.pinv(own, hermitian=True)
        state.local_frame_covariances = self.covariance[:, 3:, 3:] - gain @ transpose(shared)
        state.in_local_frame = in_local_frame
        self.mean = poses
        self._move(np.arange(len(state)), matvec(gain, drawn))
        self.covariance = np.zeros_like(own)
        return _SampledInFrames(self.mean, state=state)

    def _jacobian(self, seen: Innovation) -> FloatArray:
        if not self.has_local_frames:
            return seen.by_pose
        return seen.by_pose @ self._errors(self.state.landmark_in_local_frame[seen.rows, seen.columns], seen.rows)

    def _errors(self, sides: NDArray[np.bool_], rows: IntArray | slice = slice(None)) -> FloatArray:
        """Jacobians (R, 3, 6) of the pose errors by e and d: in the local frame where `sides` (R,), else in the map."""
        across = self.state.in_local_frame[rows].astype(float) - sides
        errors = np.zeros((len(sides), 3, 6))
        errors[:, :, :3] = np.eye(3)
        errors[:, :, 3:] = across[:, None, None] * lever_arm_jacobian(self.state.local_frames[rows], self.mean[rows])
        return errors

    def _move(self, rows: IntArray, by: FloatArray) -> None:
        """Move local frames by (R, 3) with all their landmarks, and the robot where it is in one."""
        state = self.state
        before = state.local_frames[rows]
        after = before + by
        after[:, 2] = wrap(after[:, 2])
        moved = compose(after, inverse(before))
        state.local_frames[rows] = after
        points = state.positions[rows]
        inside = state.landmark_in_local_frame[rows]
        state.positions[rows] = np.where(inside[:, :, None], transform_points(moved[:, None], points), points)
        inside = state.in_local_frame[rows]
        self.mean[rows] = np.where(inside[:, None], compose(moved, self.mean[rows]), self.mean[rows])


@final
@dataclass(frozen=True, eq=False)
class _SampledInFrames(SampledPoses):
    """Sampled poses, each exact in its own frame."""

    state: LandmarkParticles = field(kw_only=True)

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Covariance (R, 3, 3) of the poses as seen from landmarks (rows, columns): of those in the other frame."""
        state = self.state
        other = state.in_local_frame[rows] != state.landmark_in_local_frame[rows, columns]
        L = lever_arm_jacobian(state.local_frames[rows], self.poses[rows])
        return np.asarray(transform_covariances(L, state.local_frame_covariances[rows]) * other[:, None, None])


def _volume(covariances: FloatArray) -> FloatArray:
    """Determinants (N,) of covariances (N, 3, 3), by which they compare whatever the units of their parts."""
    return np.asarray(np.linalg.det(covariances + _EXACT * np.eye(3)))
