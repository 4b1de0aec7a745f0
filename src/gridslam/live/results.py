"""The results of a finished run of any command, at any time of the run."""

from __future__ import annotations

from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.live.ancestry_tree import Float32Array
from gridslam.live.history import LOST, History
from gridslam.live.scene import NO_LANDMARKS, NO_SERIES, Frame, finite_or_none
from gridslam.slam.pose_graph.descent import squared_mahalanobis
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

_MOST_RESIDUALS = 1000  # edges


@final
class MappedRun:
    """Results of `gridslam map`: the steps are the key scans of the newest drive.

    Parameters
    ----------
    history : History
        The past of the run; at least one key scan.
    trajectory : Trajectory
        The full SLAM trajectory: a pose for each scan.
    key_poses : (K, 3) float64
        The poses of the key scans in it, of earlier drives first.
    grid : OccupancyGrid
        The map.
    """

    step = "key scan"
    missing = ""
    layers = ("map", "path", "closures", "n_eff", "latency")
    landmarks = NO_LANDMARKS

    def __init__(self, history: History, trajectory: Trajectory, key_poses: FloatArray, grid: OccupancyGrid) -> None:
        """Prepare the data of all times."""
        stamps_ns = np.array(history.stamps_ns)
        own = trajectory.stamps_ns >= stamps_ns[0]
        self.grid = grid
        self.trajectory = Trajectory(trajectory.stamps_ns[own], trajectory.poses[own])
        self._scan_times_s = _elapsed(self.trajectory.stamps_ns, stamps_ns[0])
        self.times_s = _elapsed(stamps_ns, stamps_ns[0])
        self.times_s[-1] = max(self.times_s[-1], self._scan_times_s[-1])  # scans follow the last key scan
        self.path: Float32Array = key_poses[-len(stamps_ns) :, :2].astype(np.float32)
        self.series: Float32Array = np.column_stack([self.times_s, history.series[:, 1:]]).astype(np.float32)
        self._history = history
        pairs = history.shown_closures
        self._closure_ends = key_poses[pairs[pairs[:, 1] < len(key_poses)], :2].reshape(-1, 4).astype(np.float32)

    def frame(self, at: int) -> Frame:
        """Return the final trajectory up to a key scan, and all loop closures."""
        return Frame(self.path[: at + 1], closures=self._closure_ends)

    def status(self, at: int, time_s: float) -> dict[str, Any]:
        """Return values at a time at or after a key scan."""
        scan = max(int(np.searchsorted(self._scan_times_s, time_s, "right")) - 1, 0)
        return {**self._history.describe(at), "scans": scan + 1, "pose": self.trajectory.poses[scan].tolist()}


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
