"""Local frame of a FastSLAM 2.0 particle: landmarks first observed from an uncertain pose.

After an interval without observations the pose is uncertain by decimetres, and landmarks that are then observed for the
first time have the same error. Sampling that pose would fix all of them: particles with other samples are lost by
resampling long before the robot observes known landmarks again. So it is not sampled. The new landmarks are kept in a
local frame, and the pose of this frame is a Gaussian that is corrected by a Kalman update whenever landmarks of both
frames are observed. The remaining pose is sampled: in the local frame or in the map frame, whichever holds the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.slam.landmarks.small_gaussians import draw_poses, inverse_2x2, matvec, transform_covariances, transpose
from gridslam.types import FloatArray, IntArray

if TYPE_CHECKING:
    from gridslam.slam.landmarks.filters import Innovation
    from gridslam.slam.landmarks.particles import LandmarkParticles

__all__ = ["LocalFrameBelief", "lever_arm_jacobian"]

_ROUNDING = 1e-12  # of a variance: where less than that is left, its correlations are nonsense
_EXACT = 1e-6  # m^2 and rad^2: what is known to 1 mm and 1 mrad is not known better by less


def lever_arm_jacobian(local_frames: FloatArray, points: FloatArray) -> FloatArray:
    """Jacobians (..., 3, 3), for points two rows, of poses or points (..., 2 and more) by local frames (..., 3)."""
    moves = np.zeros((*points.shape[:-1], 3, 3))
    moves[..., 0, 0] = moves[..., 1, 1] = moves[..., 2, 2] = 1.0
    moves[..., 0, 2], moves[..., 1, 2] = local_frames[..., 1] - points[..., 1], points[..., 0] - local_frames[..., 0]
    return moves


@final
@dataclass(slots=True, eq=False)
class LocalFrameBelief:
    """Joint Gaussian of the pose and of the local frame of each particle within one step.

    With the error e of the pose and the error d of the local frame, the pose errs by e + s L d, where s is 1 if the
    robot is in the local frame and 0 otherwise, and L is the lever. An observation of a landmark in the frame of the
    robot depends on e only; otherwise on e + (s - f) L d, where f is 1 for landmarks in the local frame. Or, with
    odometry errors b that move a landmark by A b, an observation of it depends on e - A b.

    Attributes
    ----------
    state : LandmarkParticles
        Its local frame and the landmarks in it move as they are corrected.
    mean : (N, 3 + B) float64
        Poses, map frame, and the estimated odometry errors; if there are any (B > 0) there are no local frames.
    covariance : (N, 3 + B, 3 + B) or (N, 6, 6) float64
        Of e and b, or of e and d if any particle has a local frame.
    replaced : (N, 5) float64 or None
        `state.current_local_frames()` with the last pose of local frames that were replaced.
    """

    state: LandmarkParticles
    mean: FloatArray
    covariance: FloatArray
    replaced: FloatArray | None = None

    @classmethod
    def of(cls, state: LandmarkParticles, mean: FloatArray, spread: FloatArray) -> LocalFrameBelief:
        """Begin a step with means (N, 3 + B) and covariances (N, 3 + B, 3 + B)."""
        if not state.local_frame_covariances.any():
            return cls(state, mean, spread)
        covariance = np.zeros((len(mean), 6, 6))
        covariance[:, :3, :3], covariance[:, 3:, 3:] = spread, state.local_frame_covariances
        return cls(state, mean, covariance)

    @property
    def poses(self) -> FloatArray:
        """Mean poses (N, 3)."""
        return self.mean[:, :3]

    @property
    def estimates_bias(self) -> bool:
        """Whether errors of the odometry are learned."""
        return bool(self.mean.shape[1] > 3)

    @property
    def has_local_frames(self) -> bool:
        """Whether any particle has a local frame."""
        return bool(self.covariance.shape[1] > self.mean.shape[1])

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Covariance (R, 3, 3) of the poses as seen from landmarks (rows, columns)."""
        if not (self.estimates_bias or self.has_local_frames):
            return self.covariance[rows]
        return transform_covariances(self._errors_seen_from(rows, columns), self.covariance[rows])

    def bound_covariance(self) -> FloatArray:
        """Upper bound (N, 3, 3) of the pose covariance relative to any landmark."""
        if self.estimates_bias:
            turned = transform_covariances(self.state.positions_by_bias, self.covariance[:, None, 3:, 3:])
            most = np.trace(turned, axis1=2, axis2=3).max(axis=1, initial=0.0)
            return np.asarray(2 * (self.covariance[:, :3, :3] + most[:, None, None] * np.diag([1.0, 1.0, 0.0])))
        if not self.has_local_frames:
            return self.covariance
        L = lever_arm_jacobian(self.state.local_frames, self.mean)
        # Of e +- L d, whose covariance between the two is at most what they have by themselves.
        return np.asarray(2 * (self.covariance[:, :3, :3] + transform_covariances(L, self.covariance[:, 3:, 3:])))

    def correct(self, seen: Innovation) -> None:
        """Condition on an observation, where it has a landmark.

        Equations 13.26 to 13.28 in the form of a Kalman gain, which needs no inverse of the motion's covariance: that
        may be singular.
        """
        rows, before = seen.rows, self.covariance[seen.rows]
        more = self.estimates_bias or self.has_local_frames
        H = seen.by_pose @ self._errors_seen_from(rows, seen.columns) if more else seen.by_pose
        shared = before @ transpose(H)
        gain = shared @ inverse_2x2(seen.covariances)
        shift = matvec(gain, seen.residuals)
        self.covariance[rows] = before - gain @ transpose(shared)
        self.mean[rows] += shift[:, : self.mean.shape[1]]
        self.mean[:, 2] = wrap(self.mean[:, 2])
        if self.has_local_frames:
            self._move(rows, shift[:, 3:])
        elif self.estimates_bias:
            turned = self.state.positions_by_bias[rows] @ shift[:, None, 3:, None]
            self.state.positions[rows] += turned[..., 0]

    def open_local_frame(self, only_new: IntArray, rng: np.random.Generator) -> None:
        """Open a new local frame, with the covariance of the pose, in particles (R,) that observe only new landmarks.

        It replaces a less uncertain local frame, which is sampled: each particle has one.
        """
        if self.estimates_bias:
            return
        own = self.covariance[only_new, :3, :3]
        rows = only_new[_volume(own) > _volume(self.state.local_frame_covariances[only_new])]
        if not len(rows):
            return
        state = self.state
        if self.has_local_frames:
            still = np.zeros((len(rows), 3))
            self._move(rows, draw_poses(still, self.covariance[rows, 3:, 3:], rng))
        else:
            self.covariance = np.pad(self.covariance, ((0, 0), (0, 3), (0, 3)))
        self.covariance[rows, 3:, 3:] = self.covariance[rows, :3, :3]
        self.covariance[rows, :3, :3] = 0.0
        state.in_local_frame[rows] = False
        self.replaced = state.current_local_frames()
        state.local_frames[rows] = self.mean[rows]
        state.in_local_frame[rows], state.landmark_in_local_frame[rows] = True, False
        state.local_frame_step[rows] = state.ancestry.steps  # the step that is being taken

    def draw(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Sample the part of the poses that is independent of the Gaussian parts.

        Returns poses and errors of the odometry (N, 3 + B), and what covariance (N, 3 + B, 3 + B) is left.
        """
        if self.has_local_frames:
            return self._draw_by_local_frame(rng)
        own, left = self.covariance, np.zeros_like(self.covariance)
        if self.estimates_bias:
            own, left = _split_off_bias(self.covariance)
        self.mean[:, :3] = draw_poses(self.mean[:, :3], own, rng)
        return self.mean, left

    def _draw_by_local_frame(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Sample the poses in the frame with the smaller covariance and condition the local frame on them."""
        state = self.state
        seen_from = [self._errors(np.full(len(state), side)) for side in (False, True)]
        in_map, on_raft = (transform_covariances(errors, self.covariance) for errors in seen_from)
        better = _volume(on_raft) - _volume(in_map)
        in_local_frame = (better < 0) | (state.in_local_frame & (better == 0))
        own, errors = (np.where(in_local_frame[:, None, None], b, a) for a, b in ((in_map, on_raft), seen_from))
        poses = draw_poses(self.mean, own, rng)
        drawn = poses - self.mean
        drawn[:, 2] = wrap(drawn[:, 2])
        shared = self.covariance[:, 3:] @ transpose(errors)
        gain = shared @ np.linalg.pinv(own, hermitian=True)
        state.local_frame_covariances = self.covariance[:, 3:, 3:] - gain @ transpose(shared)
        state.in_local_frame, self.mean = in_local_frame, poses
        self._move(np.arange(len(state)), matvec(gain, drawn))
        return self.mean, np.zeros_like(own)

    def cross_frame_covariance(self, rows: IntArray, columns: IntArray) -> FloatArray | None:
        """Covariance (R, 3, 3) that drawn poses have as seen from landmarks (rows, columns) on the other side."""
        if not self.has_local_frames:
            return None
        other = self.state.in_local_frame[rows] != self.state.landmark_in_local_frame[rows, columns]
        L = lever_arm_jacobian(self.state.local_frames[rows], self.mean[rows])
        return np.asarray(transform_covariances(L, self.state.local_frame_covariances[rows]) * other[:, None, None])

    def _errors_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Jacobians (R, 3, 3 + B or 6) of the poses' errors as seen from landmarks (rows, columns)."""
        if self.has_local_frames:
            return self._errors(self.state.landmark_in_local_frame[rows, columns], rows)
        errors = np.zeros((len(rows), *self.covariance.shape[1:]))[:, :3]
        errors[:, :, :3] = np.eye(3)
        errors[:, :2, 3:] = -self.state.positions_by_bias[rows, columns]
        return errors

    def _errors(self, sides: NDArray[np.bool_], rows: IntArray | slice = slice(None)) -> FloatArray:
        """Jacobians (R, 3, 6) of the pose errors by e and d: in the local frame where `sides` (R,), else in the map."""
        state = self.state
        errors = np.zeros((len(sides), 3, 6))
        errors[:, :, :3] = np.eye(3)
        across = state.in_local_frame[rows].astype(float) - sides
        errors[:, :, 3:] = across[:, None, None] * lever_arm_jacobian(state.local_frames[rows], self.mean[rows])
        return errors

    def _move(self, rows: IntArray, by: FloatArray) -> None:
        """Move local frames by (R, 3) with all their landmarks."""
        state, before = self.state, self.state.local_frames[rows]
        after = before + by
        after[:, 2] = wrap(after[:, 2])
        moved = compose(after, inverse(before))
        state.local_frames[rows] = after
        points = state.positions[rows]
        on = state.landmark_in_local_frame[rows]
        state.positions[rows] = np.where(on[:, :, None], transform_points(moved[:, None], points), points)
        in_local_frame = state.in_local_frame[rows]
        self.mean[rows] = np.where(in_local_frame[:, None], compose(moved, self.mean[rows]), self.mean[rows])


def _split_off_bias(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split joint covariances (N, 3 + B, 3 + B): what of the poses is independent of the errors (N, 3, 3), the rest."""
    rest = (covariances + transpose(covariances)) / 2  # what is never drawn adds up its rounding, too
    whole, shared = rest[:, :3, :3].copy(), rest[:, :3, 3:]
    rest[:, :3, :3] = shared @ np.linalg.inv(rest[:, 3:, 3:]) @ transpose(shared)
    return whole - rest[:, :3, :3] + _ROUNDING * np.eye(3) * whole, rest


def _volume(covariances: FloatArray) -> FloatArray:
    """Determinants (N,) of covariances (N, 3, 3), by which they compare whatever the units of their parts."""
    return np.asarray(np.linalg.det(covariances + _EXACT * np.eye(3)))
