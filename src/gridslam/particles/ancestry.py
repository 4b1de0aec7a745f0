"""Ancestry: the pasts of all particles as one pruned tree."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from copy import deepcopy
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import Limits
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.serialization import read_array
from gridslam.types import FloatArray, IntArray


class _Stretch(NamedTuple):
    """Steps between two resamplings, of K nodes each: node i of a step is the one child of node i of that before."""

    poses: array[float]  # (S, K, 3), step by step
    parents: IntArray  # (K,) of the first step's nodes, places in the stretch before


@final
@checked
class Ancestry:
    """Who descends from whom, so that the full trajectory of any particle can be had.

    All particles step together, so the tree is kept stretch by stretch from one resampling to the next: the nodes of
    its steps and, for those of the first one, the parent's place among the nodes before. At a resampling nodes without
    a living descendant are dropped, from the newest stretch back to one that loses nothing. Stretches where a single
    node is left, hence the past that all particles share, move into the trunk, a plain array. Memory is 24 bytes for
    each step of the trunk and for each node since the last common ancestor of all, which lies of the order of N
    resamplings back, however long the run. Where nothing is ever resampled nothing can be forgotten.

    What else belongs to a pose for good may stand behind it: then there are W > 3 numbers where 3 are spoken of.

    A state has one owner: `extend` and `resample` change the object; `snapshot` keeps a copy for later.
    """

    __slots__ = ("_leaves", "_stretches", "_trunk", "_width")

    def __init__(self, leaves: IntArray, trunk: FloatArray) -> None:
        """Let particles at places `leaves` (N,), all 0, share the past `trunk` (S, 3); use `start` or `from_arrays`."""
        self._leaves = leaves  # (N,) each particle's place in the newest step
        self._stretches: list[_Stretch] = []
        self._trunk = array("d", trunk.tobytes())
        self._width: int = trunk.shape[1]

    @classmethod
    def start(cls, poses: ArrayLike) -> Ancestry:
        """Begin with step 0: N particles at poses (N, 3) [m, m, rad]. Raises ArgumentError for another shape."""
        count, width = np.shape(poses) if np.ndim(poses) == 2 else (0, 0)
        if count == 0 or width < 3:
            raise ArgumentError("poses", "shape (N, 3) with N >= 1", np.shape(poses))
        ancestry = cls(np.zeros(count, dtype=np.int64), np.empty((0, width)))
        ancestry.extend(poses)
        return ancestry

    @classmethod
    def from_trajectory(cls, trajectory: FloatArray, particles: Annotated[int, Limits(1, 1 << 30)]) -> Ancestry:
        """Begin with N particles that all share one past, poses (T, 3)."""
        return cls(np.zeros(particles, dtype=np.int64), trajectory)

    def extend(self, poses: ArrayLike) -> None:
        """Add one step: particle i, whichever its past, is now at poses[i] of (N, 3), which is copied.

        Raises ArgumentError if there is not one pose for each particle.
        """
        copy = np.array(poses, dtype=np.float64)
        expected = len(self), self._width
        if copy.shape != expected:
            raise ArgumentError("poses", f"shape {expected}", copy.shape)
        self._append(copy, self._leaves)
        self._leaves = np.arange(len(copy), dtype=np.int64)
        self._coalesce()

    def resample(self, parents: ArrayLike) -> None:
        """Make particle i a child of particle parents[i], and drop the histories of particles without children.

        Parameters
        ----------
        parents : (M,) integer
            In [0, N), in any order; M >= 1 is the number of particles from now on.

        Raises
        ------
        ArgumentError
            If they are anything else.
        """
        chosen = np.asarray(parents)
        if chosen.ndim != 1 or len(chosen) == 0 or not np.issubdtype(chosen.dtype, np.integer):
            raise ArgumentError("parents", "integers (M,) with M >= 1", f"{chosen.dtype} {chosen.shape}")
        if chosen.min() < 0 or chosen.max() >= len(self):
            raise ArgumentError("parents", f"indices in [0, {len(self)})", f"{chosen.min()} to {chosen.max()}")
        self._leaves = self._leaves[chosen]
        self._prune()

    def retract(self) -> FloatArray:
        """Take back the newest of at least two steps, also after a resampling; poses (N, 3) of the step before it."""
        if self._stretches:
            poses, parents = self._stretches[-1]
            del poses[-len(parents) * self._width :]
            if not poses:
                self._leaves = self._stretches.pop().parents[self._leaves]
        else:
            del self._trunk[-self._width :]
        newest = self._poses_of(self._stretches[-1])[-1] if self._stretches else self._trunk_poses[-1:]
        return newest[self._leaves]

    def trajectory(self, particle: int) -> FloatArray:
        """Return poses (T, 3) of one particle at steps 0 .. T - 1, along its own past.

        Raises ArgumentError unless `particle` is in [0, N).
        """
        if not 0 <= particle < len(self):
            raise ArgumentError("particle", f"an index in [0, {len(self)})", particle)
        place = self._leaves[particle]
        past: list[FloatArray] = []  # newest first
        for stretch in reversed(self._stretches):
            past.append(self._poses_of(stretch)[:, place])
            place = stretch.parents[place]
        return np.concatenate([self._trunk_poses, *reversed(past)])

    def snapshot(self) -> Ancestry:
        """Return an independent copy."""
        return deepcopy(self)

    def __len__(self) -> int:
        """Return the number of particles N."""
        return len(self._leaves)

    @property
    def steps(self) -> int:
        """Number T of steps so far."""
        nodes = len(self._trunk) + sum(len(poses) // len(parents) for poses, parents in self._stretches)
        return nodes // self._width

    @property
    def first_pose(self) -> FloatArray:
        """Pose (3,) of one particle at step 0."""
        return np.array((self._trunk or self._stretches[0].poses)[:3])

    @property
    def _trunk_poses(self) -> FloatArray:
        """Poses (S, 3) of the steps that all particles share."""
        return np.array(self._trunk).reshape(-1, self._width)

    def _poses_of(self, stretch: _Stretch) -> FloatArray:
        """View the poses (S, K, 3) of a stretch; nothing can be added to it while there is a view."""
        return np.frombuffer(stretch.poses).reshape(-1, len(stretch.parents), self._width)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as plain arrays, for a file.

        Returns
        -------
        dict
            `trunk` (S, 3) float64: poses of the shared steps; `counts` (T - S,) int64: nodes of each step after them;
            `poses` (sum of counts, 3) float64 and `parents` (sum of counts,) int64: those nodes, step by step, a parent
            being a place among the nodes of the step before (0 for the trunk's end, and where there is none);
            `leaves` (N,) int64: each particle's place among the nodes of the last step.
        """
        levels = [
            (poses, np.arange(len(poses)) if step else stretch.parents)
            for stretch in self._stretches
            for step, poses in enumerate(self._poses_of(stretch))
        ]
        return {
            "trunk": self._trunk_poses,
            "counts": np.array([len(parents) for _, parents in levels], dtype=np.int64),
            "poses": np.concatenate([np.empty((0, self._width)), *(poses for poses, _ in levels)]),
            "parents": np.concatenate([np.empty(0, dtype=np.int64), *(parents for _, parents in levels)]),
            "leaves": self._leaves.copy(),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Ancestry:
        """Restore the state that `to_arrays` returned; later results are identical.

        Raises ArgumentError if the arrays are not such a state: a wrong shape or type, or a node that is nobody's past.
        """
        trunk = read_array(arrays, "trunk", np.float64, (None, 3))
        counts = read_array(arrays, "counts", np.int64, (None,))
        if (counts < 1).any():
            raise ArgumentError("counts", "at least one node a step", counts.min())
        ends = np.cumsum(counts)
        nodes = int(counts.sum())
        poses = read_array(arrays, "poses", np.float64, (nodes, 3))
        parents = read_array(arrays, "parents", np.int64, (nodes,))
        leaves = read_array(arrays, "leaves", np.int64, (None,))
        levels = [(poses[e - k : e], parents[e - k : e]) for k, e in zip(counts, ends, strict=True)]
        places = [*(own for _, own in levels), leaves]
        for count, used in zip([1, *counts], places, strict=True):
            if not np.array_equal(np.unique(used), np.arange(count)):
                raise ArgumentError("parents, leaves", f"every one of {count} nodes of the step before, no other", used)
        if len(trunk) + len(levels) == 0:
            raise ArgumentError("trunk, counts", "at least one step", 0)
        ancestry = cls(leaves, trunk)
        for level in levels:
            ancestry._append(*level)
        ancestry._coalesce()
        return ancestry

    def _append(self, poses: FloatArray, parents: IntArray) -> None:
        """Add a step of nodes at poses (K, 3) with parents at places (K,) of the step before."""
        if self._stretches and np.array_equal(parents, np.arange(len(self._stretches[-1].parents))):
            self._stretches[-1].poses.frombytes(poses.tobytes())
        else:
            self._stretches.append(_Stretch(array("d", poses.tobytes()), parents))

    def _prune(self) -> None:
        """Drop nodes without a living descendant."""
        used = self._leaves
        for k in range(len(self._stretches) - 1, -1, -1):
            _, parents = stretch = self._stretches[k]
            kept, places = np.unique(used, return_inverse=True)
            if len(kept) == len(parents):
                break
            if k + 1 < len(self._stretches):
                self._stretches[k + 1] = self._stretches[k + 1]._replace(parents=places)
            else:
                self._leaves = places
            used = parents[kept]
            self._stretches[k] = _Stretch(array("d", self._poses_of(stretch)[:, kept].tobytes()), used)
        self._coalesce()

    def _coalesce(self) -> None:
        """Move the leading stretches of a single node into the trunk."""
        while self._stretches and len(self._stretches[0].parents) == 1:
            self._trunk += self._stretches.pop(0).poses
