"""The results of a finished run of any command, at any time of the run."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, final

import numpy as np

from gridslam.io.results.record import Record, RecordFlag
from gridslam.live.ancestry_replay import AncestryReplay
from gridslam.live.monitor import LOST
from gridslam.live.run import finite_or_none
from gridslam.live.scene import (
    NO_CLOSURES,
    NO_LANDMARKS,
    NO_PARTICLES,
    NO_POINTS,
    NO_SERIES,
    NO_TREE,
    AncestryTree,
    Float32Array,
    full_tree,
)  # fmt: skip
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

__all__ = ["MappedRun", "ReplayFrame", "Results", "StaticMap", "TrajectoryRun"]


class ReplayFrame(NamedTuple):
    """The parts of a `gridslam.live.scene.Scene` at one step; the path ends at that step."""

    path: Float32Array
    particles: Float32Array = NO_PARTICLES
    tree: AncestryTree = NO_TREE
    closures: Float32Array = NO_CLOSURES


class Results(Protocol):
    """A finished run of T steps, T >= 1."""

    @property
    def grid(self) -> OccupancyGrid | None:
        """The map; None if there is none."""

    @property
    def particles(self) -> int:
        """Number of selectable particles."""

    @property
    def times_s(self) -> FloatArray:
        """Times (T,) of the steps since the first one, never going back."""

    @property
    def series(self) -> Float32Array:
        """As in a scene; (T, 5), or (0, 5) without charts."""

    @property
    def path(self) -> Float32Array:
        """The full path (T, 2); (0, 2) if there is none."""

    @property
    def landmarks(self) -> Float32Array:
        """As in a scene."""

    def frame(self, at: int) -> ReplayFrame:
        """Return the frame at a step."""

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Values at a time at or after step `at`, as JSON values."""

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return the descendant or ancestor at step `after` of a particle at `before`; -1 if there is none."""


@final
class MappedRun:
    """Results of `gridslam map`: the steps are the key scans.

    Parameters
    ----------
    record : Record
        The particles at each key scan; at least one key scan.
    trajectory : Trajectory
        The full SLAM trajectory: a pose for each scan.
    key_poses : (T, 3) float64
        The poses of the key scans in it.
    grid : OccupancyGrid
        The map.
    closures : (C, 2) int64
        Key scans of the loop closures, the older one first.
    """

    landmarks = NO_LANDMARKS

    def __init__(
        self, record: Record, trajectory: Trajectory, key_poses: FloatArray, grid: OccupancyGrid, closures: IntArray
    ) -> None:
        """Prepare the data of all times."""
        self.grid, self.particles = grid, record.poses.shape[1]
        self.times_s = _elapsed(record.stamps_ns, record.stamps_ns[0])
        self.path: Float32Array = key_poses[:, :2].astype(np.float32)
        columns = (self.times_s, record.n_eff, 1e3 * record.latency_s, record.flags)
        counts = np.full(len(record), self.particles)
        self.series: Float32Array = np.column_stack([*columns, counts]).astype(np.float32)
        self._record, self._trajectory, self._ancestry = record, trajectory, AncestryReplay(record)
        self._scan_times_s = _elapsed(trajectory.stamps_ns, record.stamps_ns[0])
        self._closure_steps: IntArray = np.sort(closures[:, 1])  # at which step each closure was found
        order = np.argsort(closures[:, 1], kind="stable")
        self._closure_ends = key_poses[closures[order], :2].reshape(-1, 4).astype(np.float32)

    def frame(self, at: int) -> ReplayFrame:
        """Return the frame at a key scan."""
        record = self._record
        particles = np.column_stack([record.poses[at], np.exp(record.log_weights[at])]).astype(np.float32)
        return ReplayFrame(
            self.path[: at + 1],
            particles,
            full_tree(self._ancestry.at(at)),
            self._closure_ends[: self._count_closures(at)],
        )

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Values at a time at or after a key scan."""
        record = self._record
        scan = max(int(np.searchsorted(self._scan_times_s, time_s, "right")) - 1, 0)
        return {
            "keys": at + 1, "scans": scan + 1, "pose": self._trajectory.poses[scan].tolist(),
            "n_eff": finite_or_none(float(record.n_eff[at])), "lost": bool(record.flags[at] & RecordFlag.LOST),
            "best": int(record.parents[at, record.best[at]]), "closures": self._count_closures(at),
            "particles": self.particles,
        }  # fmt: skip

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return the descendant or ancestor at key scan `after` of a particle at `before`; -1 if there is none."""
        return self._ancestry.find_relative(particle, before, after)

    def _count_closures(self, at: int) -> int:
        return int(np.searchsorted(self._closure_steps, at, "right"))


@final
class TrajectoryRun:
    """A trajectory without particles, as `gridslam localize` and `gridslam landmarks` write it.

    Parameters
    ----------
    trajectory : Trajectory
        T poses.
    covariances : (T, 3, 3) float64
        Covariances of the poses.
    grid : OccupancyGrid, optional
        The map.
    landmarks : (L, 5) float32
        As in a scene.
    belief : (T, 5) float64, optional
        For each pose the lost flag, the lost probability, the inlier ratio, the number of particles, and
        the effective sample size, NaN where nothing was weighed.
    """

    particles = 0

    def __init__(
        self,
        trajectory: Trajectory,
        covariances: FloatArray,
        grid: OccupancyGrid | None = None,
        landmarks: Float32Array = NO_LANDMARKS,
        belief: FloatArray | None = None,
    ) -> None:
        """Prepare the data of all times."""
        self.grid, self.landmarks = grid, landmarks
        self.times_s = _elapsed(trajectory.stamps_ns, trajectory.stamps_ns[0])
        self.path: Float32Array = trajectory.poses[:, :2].astype(np.float32)
        self.series = NO_SERIES
        self._poses, self._covariances, self._belief = trajectory.poses, covariances, belief
        if belief is not None:
            lost, _, _, particles, n_eff = belief.T
            unknown = np.full(len(lost), np.nan)
            weighed_of = np.fmax(
                np.append(particles[:1], particles[:-1]), n_eff
            )  # a lower bound while the robot is lost
            self.series = np.column_stack([self.times_s, n_eff, unknown, LOST * lost, weighed_of]).astype(np.float32)
            self.path[lost > 0] = np.nan
            weighed = np.where(np.isnan(n_eff), 0, np.arange(len(n_eff)))
            self._weighed: IntArray = np.maximum.accumulate(weighed)  # the last step with a known n_eff

    def frame(self, at: int) -> ReplayFrame:
        """Return the frame at a pose."""
        return ReplayFrame(self.path[: at + 1])

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Values at a pose."""
        values = {"pose": self._poses[at].tolist(), "covariance": self._covariances[at].tolist()}
        if self._belief is None:
            return {**values, "keys": at + 1, "landmarks": len(self.landmarks)}
        lost, lost_probability, inlier_ratio, particles, _ = self._belief[at].tolist()
        n_eff = finite_or_none(float(self._belief[self._weighed[at], 4]))
        return {
            **values, "scans": at + 1, "lost": bool(lost), "lost_probability": lost_probability,
            "inlier_ratio": inlier_ratio, "particles": int(particles), "n_eff": n_eff,
        }  # fmt: skip

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return -1: there are no particles."""
        return -1


@final
class StaticMap:
    """A map without a trajectory, as `gridslam grid` writes it.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    """

    particles, path, series, landmarks = 0, NO_POINTS, NO_SERIES, NO_LANDMARKS

    def __init__(self, grid: OccupancyGrid) -> None:
        """Create a single step."""
        self.grid, self.times_s = grid, np.zeros(1)

    def frame(self, at: int) -> ReplayFrame:
        """Return the only frame."""
        return ReplayFrame(self.path)

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Return the size of the map."""
        height, width = (side * self.grid.resolution_m for side in self.grid.known.shape)
        return {"size_m": [width, height]}

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return -1: there are no particles."""
        return -1


def _elapsed(stamps_ns: IntArray, first_ns: int) -> FloatArray:
    """Seconds since the first stamp, never going back."""
    return np.maximum.accumulate((stamps_ns - first_ns) * 1e-9)
