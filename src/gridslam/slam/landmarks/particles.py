"""The state of FastSLAM on landmarks: particles, each with a pose, a past and a Gaussian for each of its landmarks."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.models.association import NEW
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.initial import repeat_pose
from gridslam.particles.resampling import compute_spread, effective_sample_size, normalize
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.types import FloatArray, IntArray, OwnedState

_MORE = 8  # columns that are added where none is free


@dataclass(eq=False)
class PoseBelief:
    """The pose of each particle: a Gaussian whose covariance is 0 once the pose is sampled.

    Attributes
    ----------
    poses : (N, 3) float64
        Means, map frame.
    covariances : (N, 3, 3) float64
    """

    poses: FloatArray
    covariances: FloatArray


@final
@dataclass(slots=True, eq=False)
class LandmarkParticles(OwnedState):
    """State of the filter between two steps; owned and modified by the filter.

    The landmarks lie in dense arrays, a row for each particle and a column for each landmark. Copying a particle costs
    66 bytes for each column; only those that replace a dead one are copied (see `resample`): with 1000 particles, 100
    landmarks and a third of the particles dead that is 2 MB, less than a millisecond. A tree whose parts are shared
    (Montemerlo et al. 2002) would copy less and could not be computed on as one array.

    Attributes
    ----------
    poses, pose_covariances : (N, 3), (N, 3, 3) float64
        Pose, map frame, and its covariance as long as FastSLAM 2.0 waits for an observation to sample it.
    log_weights, log_ancestry : (N,) float64, nats
        Normalized; and accumulated along each particle's ancestry, relative to the greatest.
    names : (M,) int64
        Signature of the landmark in each column, if correspondences are known; otherwise -1, and each particle assigns
        its own columns.
    positions, covariances : (N, M, 2), (N, M, 2, 2) float64
        Of the landmarks, given the path.
    evidence : (N, M) float64, nats
        Log odds that each exists: -inf where the column is free, +inf where its signature is known.
    confirmed : (N, M) bool
        Confirmed landmarks.
    observations : (N, M) int64
        Number of observations of each.
    ancestry : Ancestry
        Poses of all particles, step by step, including the first one.
    """

    poses: FloatArray
    pose_covariances: FloatArray
    log_weights: FloatArray
    log_ancestry: FloatArray
    names: IntArray
    positions: FloatArray
    covariances: FloatArray
    evidence: FloatArray
    confirmed: NDArray[np.bool_]
    observations: IntArray
    ancestry: Ancestry

    @classmethod
    def at(cls, particles: int, pose: ArrayLike) -> LandmarkParticles:
        """Begin with N particles at one pose (3,); raises ArgumentError where there is no particle, or no such pose."""
        poses = repeat_pose(particles, pose)
        return cls(
            poses=poses,
            pose_covariances=np.zeros((particles, 3, 3)),
            log_weights=np.full(particles, -np.log(particles)),
            log_ancestry=np.zeros(particles),
            names=np.empty(0, np.int64),
            positions=np.empty((particles, 0, 2)),
            covariances=np.empty((particles, 0, 2, 2)),
            evidence=np.empty((particles, 0)),
            confirmed=np.empty((particles, 0), np.bool_),
            observations=np.empty((particles, 0), np.int64),
            ancestry=Ancestry.start(poses),
        )

    def __len__(self) -> int:
        """Return the number N of particles."""
        return len(self.poses)

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
        spread = self.covariances
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

    def advance(self, belief: PoseBelief, log_weights: FloatArray) -> None:
        """Move every particle, and multiply its weight by exp of (N,)."""
        self.poses = belief.poses
        self.pose_covariances = belief.covariances
        self.ancestry.extend(belief.poses)
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
        covariance = compute_spread(self.poses, self.log_weights, best)
        covariance += np.einsum("n,nij->ij", np.exp(self.log_weights), self.pose_covariances)
        columns = places[best]
        names = self.names[columns]  # below 0 where columns have no signatures
        reported = np.where((columns >= 0) & (names >= 0), names, columns)
        return LandmarkReport(self.poses[best].copy(), covariance, reported, effective_sample_size(self.log_weights))

    def snapshot(self) -> LandmarkParticles:
        """Return an independent copy for later."""
        self.require_owned()
        return deepcopy(self)

    def _grow(self) -> None:
        """Add free columns."""
        count = len(self)
        self.names = np.concatenate([self.names, np.full(_MORE, -1)])
        for name, empty in _OF_LANDMARKS.items():
            array = getattr(self, name)
            more = np.full((count, _MORE, *array.shape[2:]), empty, array.dtype)
            setattr(self, name, np.concatenate([array, more], axis=1))


# What there is of each landmark of each particle, and what stands there where there is none.
_OF_LANDMARKS = {
    "positions": 0.0,
    "covariances": 0.0,
    "evidence": -np.inf,
    "confirmed": False,
    "observations": 0,
}
_OF_PARTICLES = "poses", "pose_covariances", "log_ancestry", *_OF_LANDMARKS
