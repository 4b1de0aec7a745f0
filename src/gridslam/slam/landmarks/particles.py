"""The state of FastSLAM on landmarks: particles, each with a pose, a past and a Gaussian for each of its landmarks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ConsumedStateError
from gridslam.geometry.angles import wrap
from gridslam.kernels import backend
from gridslam.models.association import NEW
from gridslam.models.systematic_errors import NO_ERRORS, SystematicErrors
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.initial import repeat_pose
from gridslam.particles.resampling import normalize
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.slam.landmarks.small_gaussians import transform_covariances
from gridslam.types import FloatArray, IntArray, MotionSampler

_NO_BIAS = np.empty((0, 0))
_MORE = 8  # columns that are added where none is free


@final
@dataclass(slots=True, eq=False)
class LandmarkParticles:
    """State of the filter between two steps; owned and modified by the filter.

    The landmarks lie in dense arrays, a row for each particle and a column for each landmark. Copying a particle costs
    66 bytes for each column, and 16 more for each error of the odometry that is learned; only those that replace a dead
    one are copied (see `resample`): with 1000 particles, 100 landmarks and a third of the particles dead that is 2 MB,
    less than a millisecond. A tree whose parts are shared (Montemerlo et al. 2002) would copy less and could not be
    computed on as one array.

    Attributes
    ----------
    state_means : (N, 3 + B) float64
        The pose, map frame, and the B errors of the odometry that are learned.
    state_covariances : (N, 3 + B, 3 + B) float64
        Their covariance given what was drawn: of the pose what these errors explain, and all as long as drawing waits.
    pose_by_bias, positions_by_bias : (N, 3, B), (N, M, 2, B) float64
        Derivatives of the pose and of the landmarks by these errors: what was drawn of the path is the rest.
    bias_before : (N, B, 1 + B) float64
        [c, G] of what these errors were before the last step, c + G b, by what they are, b.
    log_weights, log_ancestry : (N,) float64, nats
        Normalized; and accumulated along each particle's ancestry, relative to the greatest.
    names : (M,) int64
        Signature of the landmark in each column, if correspondences are known; otherwise -1, and each particle assigns
        its own columns.
    positions, covariances : (N, M, 2), (N, M, 2, 2) float64
        Of the landmarks, given what was drawn and the errors of the odometry.
    evidence : (N, M) float64, nats
        Log odds that each exists: -inf where the column is free, +inf where its signature is known.
    confirmed : (N, M) bool
        Confirmed landmarks.
    observations : (N, M) int64
        Number of observations of each.
    ancestry : Ancestry
        Ancestry of all particles, step by step, including the first pose: `smooth_trajectory` computes
        trajectories from it.
    """

    state_means: FloatArray
    state_covariances: FloatArray
    pose_by_bias: FloatArray
    bias_before: FloatArray
    log_weights: FloatArray
    log_ancestry: FloatArray
    names: IntArray
    positions: FloatArray
    covariances: FloatArray
    positions_by_bias: FloatArray
    evidence: FloatArray
    confirmed: NDArray[np.bool_]
    observations: IntArray
    ancestry: Ancestry
    consumed: bool = False

    @classmethod
    def at(cls, particles: int, pose: ArrayLike, bias: FloatArray = _NO_BIAS) -> LandmarkParticles:
        """Begin with N particles at one pose (3,), with errors of the odometry of covariance (B, B).

        Raises ArgumentError where there is no particle, or no such pose.
        """
        poses = repeat_pose(particles, pose)
        errors = len(bias)
        spread = np.zeros((particles, 3 + errors, 3 + errors))
        spread[:, 3:, 3:] = bias
        return cls(
            state_means=np.pad(poses, ((0, 0), (0, errors))),
            state_covariances=spread,
            pose_by_bias=np.zeros((particles, 3, errors)),
            bias_before=np.zeros((particles, errors, 1 + errors)),
            log_weights=np.full(particles, -np.log(particles)),
            log_ancestry=np.zeros(particles),
            names=np.empty(0, np.int64),
            positions=np.empty((particles, 0, 2)),
            covariances=np.empty((particles, 0, 2, 2)),
            positions_by_bias=np.empty((particles, 0, 2, errors)),
            evidence=np.empty((particles, 0)),
            confirmed=np.empty((particles, 0), np.bool_),
            observations=np.empty((particles, 0), np.int64),
            ancestry=Ancestry.start(np.pad(poses, ((0, 0), (0, 1 + (5 + errors) * errors)))),
        )

    def __len__(self) -> int:
        """Return the number N of particles."""
        return len(self.state_means)

    @property
    def poses(self) -> FloatArray:
        """Poses (N, 3), map frame."""
        return self.state_means[:, :3]

    @property
    def exists(self) -> NDArray[np.bool_]:
        """Whether there is a landmark (N, M)."""
        return np.asarray(self.evidence > -np.inf)

    @property
    def best(self) -> int:
        """Index of the particle of greatest log weight accumulated along its ancestry."""
        return int(self.log_ancestry.argmax())

    def landmark_map(self) -> LandmarkMap:
        """Return the confirmed landmarks.

        With known correspondences, these are mean and covariance of each landmark over all particles. Otherwise they
        are those of the best particle, and the covariances hold given its path.
        """
        spread = self._landmark_covariances()
        if (self.names < 0).all():
            best = self.best
            kept = np.flatnonzero(self.confirmed[best])
            return LandmarkMap(kept, self.positions[best, kept], spread[best, kept], self.observations[best, kept])
        kept = np.flatnonzero(self.names >= 0)
        weights = np.exp(self.log_weights)
        positions = self.positions[:, kept]
        means = np.einsum("n,nmi->mi", weights, positions)
        apart = positions - means
        covariances = np.einsum("n,nmij->mij", weights, spread[:, kept])
        covariances += np.einsum("n,nmi,nmj->mij", weights, apart, apart)
        return LandmarkMap(self.names[kept], means, covariances, self.observations[self.best, kept])

    def column(self, name: int) -> int:
        """Return the column of the landmark with a signature, `NEW` where it has none."""
        found = np.flatnonzero(self.names == name)
        return int(found[0]) if len(found) else NEW

    def new_columns(self, particles: IntArray, name: int | None) -> IntArray:
        """Return a free column for each of some particles (K,): one of its own, or all one and the same for a name."""
        full = (self.names >= 0).all() if name is not None else self.exists[particles].all(axis=1).any()
        if full:
            self._grow()
        if name is None:
            return np.asarray(self.exists[particles].argmin(axis=1))
        column = int(self.names.argmin())
        self.names[column] = name
        return np.full(len(particles), column)

    def advance(self, known: FloatArray, spread: FloatArray, log_weights: FloatArray | None = None) -> None:
        """Give every particle its pose and errors (N, 3 + B), their covariance, and its weight (N,), if it was drawn.

        Without observations, hence without weights, poses are not drawn.
        """
        self.state_means = known
        self.state_covariances = spread
        past = np.zeros((len(self), 4))  # the pose, and whether it was drawn
        past[:, :3] = self.poses
        past[:, 3] = log_weights is not None
        if self.pose_by_bias.size:
            self.pose_by_bias = spread[:, :3, 3:] @ np.linalg.inv(spread[:, 3:, 3:])
            of_bias = known[:, 3:], *(part.reshape(len(self), -1) for part in (self.pose_by_bias, self.bias_before))
            past = np.column_stack([past, *of_bias])
        self.ancestry.extend(past)
        if log_weights is not None:
            self.log_weights = normalize(self.log_weights + log_weights)
            accumulated = self.log_ancestry + log_weights
            self.log_ancestry = accumulated - accumulated.max()

    def resample(self, drawn: IntArray) -> IntArray:
        """Replace the particles by the `drawn` ones (N,), with equal weights; return parents (N,), in another order.

        A particle that goes on stays where it is, and its further copies replace those that do not.
        """
        count = len(self)
        copies = np.bincount(drawn, minlength=count)
        parents = np.arange(count)
        dead = np.flatnonzero(copies == 0)
        parents[dead] = np.repeat(parents, np.maximum(copies - 1, 0))
        for name in _OF_PARTICLES:
            array = getattr(self, name)
            array[dead] = array[parents[dead]]
        self.ancestry.resample(parents)
        self.log_weights = np.full(count, -np.log(count))
        return parents

    def report(self, places: IntArray) -> LandmarkReport:
        """Report of the last step; places (N, K) are the columns of the observed landmarks."""
        best = self.best
        weights = np.exp(self.log_weights)
        all_of_them = np.ones(len(self), np.bool_)
        _, _, total, squares, covariance = backend.mean_shift(
            self.poses, weights, all_of_them, self.poses[best], math.inf, math.inf, 1
        )
        spread = self.state_covariances[:, :3, :3]
        if spread.any():  # not where all are drawn
            covariance += np.einsum("n,nij->ij", weights, spread)
        columns = places[best]
        names = self.names[columns]  # below 0 where columns have no signatures
        reported = np.where((columns >= 0) & (names >= 0), names, columns)
        return LandmarkReport(self.poses[best].copy(), covariance, reported, total**2 / squares)

    def take(self) -> LandmarkParticles:
        """Hand the contents over to a new owner; this one raises ConsumedStateError from now on."""
        self._check()
        self.consumed = True
        return replace(self, consumed=False)

    def snapshot(self) -> LandmarkParticles:
        """Return an independent copy for later."""
        self._check()
        arrays = {name: getattr(self, name).copy() for name in _ARRAYS}
        return LandmarkParticles(**arrays, ancestry=self.ancestry.snapshot())

    def _landmark_covariances(self) -> FloatArray:
        """Covariances of landmarks (N, M, 2, 2), including those of the odometry errors."""
        turned = transform_covariances(self.positions_by_bias, self.state_covariances[:, None, 3:, 3:])
        return self.covariances + turned

    def _grow(self) -> None:
        """Add free columns."""
        count = len(self)
        self.names = np.concatenate([self.names, np.full(_MORE, -1)])
        for name, empty in _OF_LANDMARKS.items():
            array = getattr(self, name)
            more = np.full((count, _MORE, *array.shape[2:]), empty, array.dtype)
            setattr(self, name, np.concatenate([array, more], axis=1))

    def _check(self) -> None:
        if self.consumed:
            raise ConsumedStateError


# What there is of each landmark of each particle, and what stands there where there is none.
_OF_LANDMARKS = {
    "positions": 0.0,
    "covariances": 0.0,
    "positions_by_bias": 0.0,
    "evidence": -np.inf,
    "confirmed": False,
    "observations": 0,
}
_OF_POSES = (
    "state_means",
    "state_covariances",
    "pose_by_bias",
    "bias_before",
    "log_ancestry",
)
_OF_PARTICLES = *_OF_POSES, *_OF_LANDMARKS
_ARRAYS = *_OF_PARTICLES, "log_weights", "names"


def smooth_trajectory(
    state: LandmarkParticles, particle: int, motions: Sequence[MotionSampler], bias: SystematicErrors = NO_ERRORS
) -> FloatArray:
    """Trajectory (1 + T, 3) of a particle, map frame: sampled poses, and smoothed poses between them.

    Sampled poses are corrected by the final estimate of the odometry errors. Poses that were not sampled, since nothing
    was observed, are the means of p(x_t | u, the poses sampled before and after), by one pass of a Kalman smoother. For
    FastSLAM 1.0, which samples every pose, the trajectory is the ancestry.

    Parameters
    ----------
    state : LandmarkParticles
    particle : int
        In [0, N).
    motions : sequence of MotionSampler
        The T motions that were taken since the first pose.
    bias : SystematicErrors
        The errors of the odometry that the filter learned.

    References
    ----------
    H. Rauch, F. Tung, C. Striebel, Maximum likelihood estimates of linear dynamic systems, 1965.
    """
    rows = state.ancestry.trajectory(particle)
    poses = rows[:, :3]
    drawn = rows[:, 3] > 0
    errors = _smooth_bias(poses, rows[:, 4:], len(bias))
    drawn[0] = True
    keys = np.flatnonzero(drawn)
    for begin, end in zip(keys[:-1].tolist(), keys[1:].tolist(), strict=True):
        if end > begin + 1:
            poses[begin + 1 : end] = _interpolate(poses[begin], poses[end], motions[begin:end], bias, errors[begin:end])
    for t in range(int(keys[-1]), len(poses) - 1):  # only the motion constrains these
        poses[t + 1] = bias.predict(motions[t], np.append(poses[t], errors[t])[None])[0][0, :3]
    return poses


def _smooth_bias(poses: FloatArray, rows: FloatArray, count: int) -> FloatArray:
    """Correct poses (T, 3) by the smoothed errors of the odometry (T, B), which are returned."""
    believed, by_errors, before = np.split(rows, [count, 4 * count], axis=1)
    errors = believed.copy()
    for t in range(len(rows) - 1, 0, -1):
        errors[t - 1] = before[t].reshape(count, 1 + count) @ np.append(1.0, errors[t])
    poses += (by_errors.reshape(len(rows), 3, count) @ (errors - believed)[:, :, None])[:, :, 0]
    poses[:, 2] = wrap(poses[:, 2])
    return errors


def _interpolate(
    begin: FloatArray, end: FloatArray, motions: Sequence[MotionSampler], bias: SystematicErrors, errors: FloatArray
) -> FloatArray:
    """Expected poses (K - 1, 3) between two that K motions by an odometry of errors (K, B) are apart."""
    means = [begin]
    covariances = [np.zeros((3, 3))]
    moves = list[FloatArray]()
    for motion, known in zip(motions, errors, strict=True):
        (mean,), (F,), (Q,) = bias.predict(motion, np.append(means[-1], known)[None])
        G = F[:3, :3]
        moves.append(G)
        means.append(mean[:3])
        covariances.append(G @ covariances[-1] @ G.T + Q[:3, :3])
    smoothed = np.array(means)
    smoothed[-1] = end
    for t in range(len(motions) - 1, 0, -1):
        gain = covariances[t] @ moves[t].T @ np.linalg.pinv(covariances[t + 1], hermitian=True)
        change = smoothed[t + 1] - means[t + 1]
        change[2] = wrap(change[2])
        smoothed[t] += gain @ change
    smoothed[:, 2] = wrap(smoothed[:, 2])
    return smoothed[1:-1]
