"""The pose graph: solved by GraphSLAM, built by loop closure, stored in g2o files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray, IntArray


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses, and relative measurements between pairs of them.

    Attributes
    ----------
    poses : (N, 3) float64
        Estimate or first guess, map frame. The first `held` stay where they are.
    edges : (M, 2) int64
        For each measurement the places in `poses` of the two that it joins: from, to.
    measurements : (M, 3) float64
        The pose `to` seen from the pose `from`.
    information : (M, 3, 3) float64
        Inverse covariance of the error of each measurement (see `errors`), by x, y in m and theta in rad.
    trusted : (M,) bool
        Measurements that robust estimation never rejects: odometry.
    held : int, [1, N]
        Number of poses that are known exactly: pose 0 (the gauge), or a part that is frozen.
    """

    poses: FloatArray
    edges: IntArray
    measurements: FloatArray
    information: FloatArray
    trusted: NDArray[np.bool_]
    held: int = 1

    def __repr__(self) -> str:
        """Return one line."""
        return f"PoseGraph({len(self.poses)} poses, {len(self.edges)} measurements)"

    @classmethod
    def of(
        cls,
        poses: ArrayLike,
        edges: ArrayLike,
        measurements: ArrayLike,
        information: ArrayLike,
        trusted: ArrayLike | None = None,
        held: int = 1,
    ) -> PoseGraph:
        """Validate and copy; by default edges between neighbours in the order of the poses are trusted.

        Raises
        ------
        ArgumentError
            A shape is wrong, a value is not finite, an edge joins a pose to itself or to one that is not there, an
            information matrix is not symmetric and positive definite, or no pose or more than all are held.
        """
        nodes = np.array(poses, np.float64).reshape(-1, 3)
        pairs = np.array(edges, np.int64).reshape(-1, 2)
        z = np.array(measurements, np.float64).reshape(-1, 3)
        omega = np.array(information, np.float64).reshape(-1, 3, 3)
        apart = np.abs(pairs[:, 1] - pairs[:, 0])
        trust = apart == 1 if trusted is None else np.array(trusted, np.bool_)
        if not len(nodes) or not len(pairs) == len(z) == len(omega) == len(trust):
            got = nodes.shape, pairs.shape, z.shape, omega.shape, trust.shape
            raise ArgumentError("PoseGraph", "poses (N, 3), edges (M, 2), (M, 3), (M, 3, 3), (M,)", got)
        if not all(np.isfinite(array).all() for array in (nodes, z, omega)):
            raise ArgumentError("PoseGraph", "finite poses, measurements and information", "a value that is not")
        if len(pairs) and (pairs.min() < 0 or pairs.max() >= len(nodes) or (apart == 0).any()):
            raise ArgumentError("edges", f"pairs of different places in [0, {len(nodes)})", pairs.tolist())
        if not np.allclose(omega, omega.transpose(0, 2, 1)) or (len(omega) and np.linalg.eigvalsh(omega).min() <= 0):
            raise ArgumentError("information", "symmetric positive definite matrices", "another")
        if not 1 <= held <= len(nodes):
            raise ArgumentError("held", f"1 to {len(nodes)} poses", held)
        return cls(nodes, pairs, z, omega, trust, held)

    def with_poses(self, poses: FloatArray) -> PoseGraph:
        """Return the same measurements about other poses (N, 3)."""
        return replace(self, poses=poses)

    def select(self, which: NDArray[np.bool_]) -> PoseGraph:
        """Return the graph with those of the measurements (M,) alone."""
        return replace(
            self,
            edges=self.edges[which],
            measurements=self.measurements[which],
            information=self.information[which],
            trusted=self.trusted[which],
        )

    def errors(self, poses: FloatArray | None = None) -> FloatArray:
        """Errors (M, 3) of the measurements at poses (N, 3), by default its own: g2o's.

        e = z^-1 (x_from^-1 x_to): position in the frame in which the measurement ends, heading in [-pi, pi).
        """
        at = self.poses if poses is None else poses
        return between(self.measurements, between(at[self.edges[:, 0]], at[self.edges[:, 1]]))

    def chi2(self, poses: FloatArray | None = None) -> float:
        """Sum of e' information e over the measurements."""
        e = self.errors(poses)
        return float(np.einsum("mi,mij,mj->", e, self.information, e))
