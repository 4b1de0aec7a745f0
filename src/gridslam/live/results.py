"""The results of a finished run of any command, at any time of the run."""

from __future__ import annotations

from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.results.record import Record, RecordFlag
from gridslam.live.ancestry_tree import Float32Array, full_tree
from gridslam.live.monitor import LOST
from gridslam.live.scene import NO_LANDMARKS, NO_SERIES, Frame, finite_or_none
from gridslam.particles.ancestry import Ancestry
from gridslam.slam.loop_closure.constraints import select_shown_closures
from gridslam.slam.pose_graph.descent import squared_mahalanobis
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

_MOST_RESIDUALS = 1000  # edges
_SNAPSHOTS = 32  # of the ancestry, evenly over the record: seeking back replays at most one interval


@final
class AncestryReplay:
    """Replays the ancestry of a record, forwards step by step and backwards from the previous snapshot.

    Parameters
    ----------
    record : Record
        At least one key scan.
    """

    def __init__(self, record: Record) -> None:
        """Start at the first key scan."""
        self._record = record
        self._interval = max(len(record) // _SNAPSHOTS, 1)
        self._at = 0
        self._ancestry = Ancestry.start(record.poses[0])
        self._snapshots = {0: self._ancestry.snapshot()}

    def at(self, key: int) -> Ancestry:
        """Return the ancestry at a key scan, before its resampling; valid until the next call."""
        near = max(kept for kept in self._snapshots if kept <= key)
        if not near <= self._at <= key:
            self._at = near
            self._ancestry = self._snapshots[near].snapshot()
        while self._at < key:
            self._advance()
        return self._ancestry

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return the descendant or ancestor at key scan `after` of a particle at `before`; -1 if there is none.

        Of several descendants it is the first.
        """
        parents = self._record.parents
        if particle < 0:
            return -1
        for key in range(before - 1, after - 1, -1):
            particle = int(parents[key, particle])
        if after <= before:
            return particle
        ancestors = np.arange(parents.shape[1])
        for key in range(after - 1, before - 1, -1):
            ancestors = parents[key, ancestors]
        descendants = np.flatnonzero(ancestors == particle)
        return int(descendants[0]) if len(descendants) else -1

    def _advance(self) -> None:
        record = self._record
        at = self._at
        if record.flags[at] & RecordFlag.RESAMPLED:
            self._ancestry.resample(record.parents[at])
        self._ancestry.extend(record.poses[at + 1])
        self._at = at + 1
        if self._at % self._interval == 0 and self._at not in self._snapshots:
            self._snapshots[self._at] = self._ancestry.snapshot()


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
    recognized : (C, 2) int64
        Key scans of the recognized loop closures, the older one first; the record has the tracked ones.
    online : Trajectory, optional
        The poses as they were estimated online, a pose for each scan.
    """

    layers = ("map", "path", "ancestry", "particles", "weights", "closures", "n_eff", "latency")
    step = "key scan"
    missing = ""
    landmarks = NO_LANDMARKS

    def __init__(
        self,
        record: Record,
        trajectory: Trajectory,
        key_poses: FloatArray,
        grid: OccupancyGrid,
        recognized: IntArray,
        online: Trajectory | None = None,
    ) -> None:
        """Prepare the data of all times."""
        self.online = online
        self.grid = grid
        self.particles = record.poses.shape[1]
        self.ancestry = AncestryReplay(record)
        self._scan_times_s = _elapsed(trajectory.stamps_ns, record.stamps_ns[0])
        self.times_s = _elapsed(record.stamps_ns, record.stamps_ns[0])
        self.times_s[-1] = max(self.times_s[-1], self._scan_times_s[-1])  # scans follow the last key scan
        self.path: Float32Array = key_poses[:, :2].astype(np.float32)
        columns = (self.times_s, record.n_eff, 1e3 * record.latency_s, record.flags)
        counts = record.counts
        self.series: Float32Array = np.column_stack([*columns, counts]).astype(np.float32)
        self._record = record
        self.trajectory = trajectory
        tracked = record.revisits.astype(np.int64)
        self._closure_steps: IntArray = np.sort(np.concatenate([recognized, tracked])[:, 1])  # when each was found
        shown = select_shown_closures(recognized, tracked)
        shown = shown[np.argsort(shown[:, 1], kind="stable")]
        self.shown_closures: IntArray = shown
        self._closure_ends = key_poses[shown, :2].reshape(-1, 4).astype(np.float32)

    def frame(self, at: int) -> Frame:
        """Return the frame at a key scan."""
        record = self._record
        particles = np.column_stack([record.poses[at], np.exp(record.log_weights[at])]).astype(np.float32)
        closures = self._closure_ends[: int(np.searchsorted(self.shown_closures[:, 1], at, "right"))]
        return Frame(self.path[: at + 1], full_tree(self.ancestry.at(at)), particles, closures)

    def particle_path(self, at: int, particle: int) -> Float32Array:
        """Return the online path (at + 1, 2) of a particle at a key scan, m."""
        path: Float32Array = self.ancestry.at(at).trajectory(particle)[:, :2].astype(np.float32)
        return path

    def online_pose(self, time_s: float) -> FloatArray | None:
        """Return the pose (3,) as it was estimated at a time; None if it is unknown."""
        known = self.online is not None and len(self.online) == len(self.trajectory)
        return self.online.poses[self._find_scan(time_s)] if known and self.online is not None else None

    def _find_scan(self, time_s: float) -> int:
        return max(int(np.searchsorted(self._scan_times_s, time_s, "right")) - 1, 0)

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Return values at a time at or after a key scan."""
        record = self._record
        scan = self._find_scan(time_s)
        return {
            "keys": at + 1,
            "scans": scan + 1,
            "pose": self.trajectory.poses[scan].tolist(),
            "n_eff": finite_or_none(float(record.n_eff[at])),
            "lost": bool(record.flags[at] & RecordFlag.LOST),
            "best": int(record.parents[at, record.best[at]]),
            "closures": self._count_closures(at),
            "particles": int(record.counts[at]),
        }

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
    missing : str
        A message about missing files; empty if nothing is missing.
    is_global : bool
        Whether the pose was unknown at first.
    """

    particles = 0
    ancestry = None

    def __init__(
        self,
        trajectory: Trajectory,
        covariances: FloatArray,
        grid: OccupancyGrid | None = None,
        landmarks: Float32Array = NO_LANDMARKS,
        belief: FloatArray | None = None,
        missing: str = "",
        *,
        is_global: bool = False,
    ) -> None:
        """Prepare the data of all times."""
        self.grid = grid
        self.trajectory = trajectory
        self.landmarks = landmarks
        self.times_s = _elapsed(trajectory.stamps_ns, trajectory.stamps_ns[0])
        self.path: Float32Array = trajectory.poses[:, :2].astype(np.float32)
        self.series = NO_SERIES
        self._poses = trajectory.poses
        self._covariances = covariances
        self._belief = belief
        self.missing = missing
        self.step = "step" if belief is None else "scan"
        shown = {"map": grid is not None, "path": True, "landmarks": len(landmarks) > 0}
        shown |= dict.fromkeys(("n_eff", "lost_probability"), belief is not None)
        self.layers = tuple(layer for layer, is_shown in shown.items() if is_shown)
        if belief is not None:
            lost, _, _, particles, n_eff = belief.T
            found = np.append(np.flatnonzero(lost == 0), len(lost))
            self._found_at = int(found[0]) if is_global else 0
            unknown = np.full(len(lost), np.nan)
            before = np.append(particles[:1], particles[:-1])
            weighed_of = np.fmax(before, n_eff)  # a lower bound while the robot is lost
            self.series = np.column_stack([self.times_s, n_eff, unknown, LOST * lost, weighed_of]).astype(np.float32)
            self.path[lost > 0] = np.nan
            weighed = np.where(np.isnan(n_eff), 0, np.arange(len(n_eff)))
            self._weighed: IntArray = np.maximum.accumulate(weighed)  # the last step with a known n_eff

    def frame(self, at: int) -> Frame:
        """Return the frame at a pose."""
        return Frame(self.path[: at + 1])

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Return values at a pose."""
        values = {"pose": self._poses[at].tolist(), "covariance": self._covariances[at].tolist()}
        if self._belief is None:
            return {**values, "keys": at + 1, "landmarks": len(self.landmarks)}
        lost, lost_probability, inlier_ratio, particles, _ = self._belief[at].tolist()
        n_eff = finite_or_none(float(self._belief[self._weighed[at], 4]))
        return {
            **values,
            "scans": at + 1,
            "lost": bool(lost),
            "looking": at < self._found_at,
            "lost_probability": lost_probability,
            "inlier_ratio": inlier_ratio,
            "particles": int(particles),
            "n_eff": n_eff,
        }


@final
class StaticView:
    """Results without a course of time: a map as of `gridslam grid`, a pose graph, or sessions that were merged.

    Parameters
    ----------
    grid : OccupancyGrid, optional
        The map.
    graph : PoseGraph, optional
        The poses, and the edges between them: those that do not join consecutive poses are drawn, and how much each
        contradicts the poses.
    is_landmark : (N,) bool, optional
        Which of the poses are landmarks.
    trajectory : Trajectory, optional
        The poses of all scans.
    """

    step = "key scan"
    missing = ""
    particles = 0
    ancestry = None
    series = NO_SERIES

    def __init__(
        self,
        grid: OccupancyGrid | None,
        graph: PoseGraph | None = None,
        is_landmark: NDArray[np.bool_] | None = None,
        trajectory: Trajectory | None = None,
    ) -> None:
        """Create a single step."""
        self.grid = grid
        self.trajectory = trajectory
        self.times_s = np.zeros(1)
        self.landmarks: Float32Array = NO_LANDMARKS
        self._status: dict[str, Any] = {}
        self._frame = Frame()
        if grid is not None:
            height, width = (side * grid.resolution_m for side in grid.known.shape)
            self._status["size_m"] = [width, height]
        if graph is not None:
            self._show_graph(graph, np.zeros(len(graph.poses), bool) if is_landmark is None else is_landmark)
        self.path = self._frame.path
        shown = {"map": grid, "path": graph, "closures": graph, "landmarks": len(self.landmarks) or None}
        self.layers = tuple(layer for layer, found in shown.items() if found is not None)

    def _show_graph(self, graph: PoseGraph, is_landmark: NDArray[np.bool_]) -> None:
        first, second = graph.edges.T
        closes = (np.abs(second - first) != 1) & ~is_landmark[second]
        chi2 = squared_mahalanobis(graph, graph.errors())
        worst = closes.nonzero()[0][np.argsort(-chi2[closes], kind="stable")]
        positions = graph.poses[:, :2]
        ends = positions[graph.edges[worst]].reshape(-1, 4).astype(np.float32)
        follows = np.zeros(len(positions), bool)
        follows[np.minimum(first, second)[np.abs(second - first) == 1]] = True
        breaks = np.flatnonzero(~follows[:-1] & ~is_landmark[1:]) + 1  # between drives
        path = np.insert(np.where(is_landmark[:, None], np.nan, positions), breaks, np.nan, axis=0)
        self._frame = Frame(path.astype(np.float32), closures=ends)
        self.landmarks = np.pad(positions[is_landmark], ((0, 0), (0, 3))).astype(np.float32)
        listed = zip(graph.edges[worst].tolist(), chi2[worst].tolist(), strict=True)
        self._status |= {
            "poses": int((~is_landmark).sum()),
            "edges": len(graph.edges),
            "landmarks": int(is_landmark.sum()),
            "chi2": float(chi2.sum()),
            "residuals": [[*pair, round(off, 3)] for pair, off in listed][:_MOST_RESIDUALS],
        }

    def add_status(self, values: dict[str, Any]) -> None:
        """Add values for the page."""
        self._status |= values

    def frame(self, at: int) -> Frame:
        """Return the only frame."""
        return self._frame

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Return sizes, counts, and the edges that contradict the poses most: their ends, and chi2."""
        return self._status


Results: TypeAlias = MappedRun | TrajectoryRun | StaticView
"""A finished run of T steps, T >= 1.

Attributes
----------
layers : tuple of str
    What there is to show.
step : str
    What a step is.
missing : str
    A message about missing files; empty if nothing is missing.
grid : OccupancyGrid or None
    The map; None if there is none.
particles : int
    Number of selectable particles.
ancestry : AncestryReplay or None
    Their ancestry; None if there are none.
times_s : (T,) float64
    Times of the steps since the first one, never going back.
trajectory : Trajectory or None
    The poses; None if there are none.
path : (T, 2) float32
    The full path; (0, 2) if there is none.
series, landmarks
    As in a scene.
"""


def _elapsed(stamps_ns: IntArray, first_ns: int) -> FloatArray:
    """Return seconds since the first stamp, never going back."""
    return np.maximum.accumulate((stamps_ns - first_ns) * 1e-9)
