"""Monitors of filters: they collect the page's data in the filter's thread; the server's thread renders it.

SLAM and localization send the same data to the page; what one of them does not have (pasts, closures, maps of its own)
is empty there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.live.history import RowBuffer
from gridslam.live.scene import Frame
from gridslam.live.tiles import TileChangeDetector, TileChanges
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource, select_shown_closures
from gridslam.types import IntArray, OccupancyGrid, StepReport
from gridslam.viz.cloud import select_representatives

if TYPE_CHECKING:
    from gridslam.localization import LocalizationReport, MonteCarloState

_STEPS_PER_UNIT = np.float32(64)  # per m and rad: poses are rounded to 1.6 cm and 0.9 degrees, which compress better


@final
class StateView(NamedTuple):
    """An immutable view of a filter's state.

    Attributes
    ----------
    changes : TileChanges or None
        Changed tiles of the best particle's map; None for a known map.
    resolution_m : float, m
        Side of the maps' cells.
    status : dict
        Further values for the page, as JSON values; including ``particles``, their number.
    make_frame : callable
        Returns path, particles and loop closures; called in the server's thread, as it takes time.
    """

    changes: TileChanges | None
    resolution_m: float
    status: dict[str, Any]
    make_frame: Callable[[], Frame]


@final
class ClosureCollector:
    """Collects the loop closures of a session."""

    def __init__(self) -> None:
        """Start without closures."""
        self._recognized: list[tuple[int, int]] = []
        self._tracked: list[tuple[int, int]] = []  # of the first `_seen` constraints
        self._seen = 0

    def add(self, recognized: Iterable[tuple[int, int]]) -> None:
        """Add closures recognized at a scan: the older and the later key scan of each."""
        self._recognized += recognized

    def find(self, state: GridFastSlamState) -> tuple[IntArray, int]:
        """Return the loop closures (C, 2) so far, the older key scan first, and how many are recognized: the first."""
        recognized = np.array(self._recognized, np.int64).reshape(-1, 2)
        constraints = [] if state.closure_state is None else state.closure_state.graph.constraints
        if len(constraints) < self._seen:
            self._seen = 0
            self._tracked = []
        new = constraints[self._seen :]
        self._tracked += [constraint.pair for constraint in new if constraint.source is ConstraintSource.TRACKED]
        self._seen = len(constraints)
        return np.concatenate([recognized, np.array(self._tracked, np.int64).reshape(-1, 2)]), len(recognized)


@final
class MappingMonitor:
    """Monitor of a filter that maps."""

    def __init__(self) -> None:
        """Start before the first scan."""
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session with new maps."""
        self._collector = ClosureCollector()
        self._detector = TileChangeDetector()

    def record(self, report: StepReport) -> None:
        """Record a scan."""
        self._collector.add(report.closures)
        if report.skipped is None and report.corrected:
            self._detector.forget()

    def view(self, report: StepReport, state: GridFastSlamState) -> StateView:
        """Return a view of the current state, with all changes of the maps since the last view."""
        changes = self._detector.find_changes(state.maps, state.best)
        best, poses = state.best, state.poses
        log_weights = state.log_weights
        ancestry = state.ancestry.snapshot()
        found, recognized = self._collector.find(state)
        closures = select_shown_closures(found[:recognized], found[recognized:])

        def make_frame() -> Frame:
            now = compose(poses, report.key_from_base) if report.skipped else poses
            particles = np.column_stack([now, np.exp(log_weights)]).astype(np.float32)
            path = ancestry.trajectory(best)[:, :2].astype(np.float32)
            ends = path[closures].reshape(-1, 4)  # corrections move them
            return Frame(path, particles, ends)

        status = {
            "particles": len(poses),
            "best": best,
            "closures": len(found),
            "bytes": state.maps.nbytes,
        }
        return StateView(changes, state.maps.resolution_m, status, make_frame)


@final
class LocalizationMonitor:
    """Monitor of a filter that localizes in a known map.

    Parameters
    ----------
    known : OccupancyGrid
        The map.
    """

    def __init__(self, known: OccupancyGrid) -> None:
        """Start before the first scan."""
        self._resolution_m = known.resolution_m
        self.reset()

    def reset(self) -> None:
        """Start before the first scan."""
        self._path = RowBuffer(2)

    def record(self, report: LocalizationReport) -> None:
        """Record the position at a scan, NaN if the robot is lost."""
        if report.skipped is None:
            self._path.append(np.full((1, 2), np.nan) if report.lost else report.pose[None, :2])

    def view(self, report: LocalizationReport, state: MonteCarloState) -> StateView:
        """Return a view of the current state."""
        path = self._path.rows
        state = state.snapshot()

        def make_frame() -> Frame:
            """Return at most a thousand particles, predicted by odometry since the last update."""
            chosen, ratios = select_representatives(np.exp(state.log_weights))
            moved = between(state.estimate.pose, report.pose)
            poses = compose(state.poses[chosen], moved).astype(np.float32)
            rounded = np.rint(poses * _STEPS_PER_UNIT) / _STEPS_PER_UNIT
            cloud = np.column_stack([rounded, ratios]).astype(np.float32)
            return Frame(path, particles=cloud)

        status = {
            "particles": report.particles,
            "looking": report.looking,
            "lost_probability": report.lost_probability,
            "inlier_ratio": report.inlier_ratio,
        }
        return StateView(None, self._resolution_m, status, make_frame)


FilterMonitor: TypeAlias = MappingMonitor | LocalizationMonitor
"""Collects changes from a filter's reports and states; used by the filter's thread only."""
