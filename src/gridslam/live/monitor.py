"""Monitors of filters: they collect the page's data in the filter's thread; the server's thread renders it.

SLAM and localization send the same data to the page; what one of them does not have (pasts, closures, maps of its own)
is empty there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.live.ancestry_tree import thin_tree
from gridslam.live.history import RowBuffer
from gridslam.live.scene import Frame
from gridslam.live.tiles import EMPTY_BOX, Box, TileChangeDetector, TileChanges
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource, select_shown_closures
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan, OccupancyGrid, StepReport
from gridslam.viz.cloud import select_representatives

if TYPE_CHECKING:
    from gridslam.localization import LocalizationReport, MonteCarloState

BEST = 0
"""The channel that always shows the map of the best particle."""

_DIED_OUT = -1
_MAX_RESAMPLINGS = 256
_STEPS_PER_UNIT = np.float32(64)  # per m and rad: poses are rounded to 1.6 cm and 0.9 degrees, which compress better


@final
class StateView(NamedTuple):
    """An immutable view of a filter's state.

    Attributes
    ----------
    maps : dict of int to TileChanges
        Changed tiles of the map of each channel.
    rows : dict of int to int
        Particle of each channel; -1 if it has no descendants.
    resolution_m : float, m
        Side of the maps' cells.
    status : dict
        Further values for the page, as JSON values; including ``particles``, their number.
    make_frame : callable
        Returns path, particles and loop closures; called in the server's thread, as it takes time.
    """

    maps: dict[int, TileChanges]
    rows: dict[int, int]
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
    """Monitor of a filter that maps.

    Parameters
    ----------
    range_max_m : float, m
        Beams of this range or more do not change the map; infinite if unknown.
    """

    def __init__(self, range_max_m: float) -> None:
        """Start before the first scan."""
        self._range_max_m = range_max_m
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session with new maps."""
        self._all_changed = True
        self._maps: TileMaps | None = None
        self._keys = 0
        self._written: list[tuple[FloatArray, LaserScan | None]] = []
        self._collector = ClosureCollector()
        self._resamplings: deque[tuple[int, IntArray]] = deque(maxlen=_MAX_RESAMPLINGS)
        self._detectors = {BEST: TileChangeDetector()}
        self._lines: dict[int, IntArray] = {}  # of each channel the descendants of the selected particle
        self._was_searched = False  # the robot, in what earlier drives have left

    def record(self, report: StepReport, scan: LaserScan | None) -> None:
        """Record a scan."""
        self._collector.add(report.closures)
        if report.skipped is not None:
            return
        self._keys += 1
        self._all_changed |= report.corrected
        if report.poses is not None:
            self._written.append((report.poses, scan))
        if report.parents is not None:
            self._resamplings.append((self._keys, report.parents))
            self._lines = {channel: _find_children(line, report.parents) for channel, line in self._lines.items()}

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle and its descendants as a channel; -1 closes the channel."""
        if particle < 0:
            self._detectors.pop(channel, None)
            self._lines.pop(channel, None)
            return
        line = np.array([particle])
        for key, parents in self._resamplings:
            if key > keys:
                line = _find_children(line, parents)
        self._detectors[channel] = TileChangeDetector()
        self._lines[channel] = line

    def view(self, report: StepReport, state: GridFastSlamState) -> StateView:
        """Return a view of the current state, with all changes of the maps since the last view."""
        rows = {channel: int(line[0]) if len(line) else _DIED_OUT for channel, line in self._lines.items()}
        rows[BEST] = state.best
        maps = self.find_changes(state, rows)
        poses = state.poses
        log_weights = state.log_weights
        ancestry = state.ancestry.snapshot()
        found, recognized = self._collector.find(state)
        closures = select_shown_closures(found[:recognized], found[recognized:])

        def make_frame() -> Frame:
            now = compose(poses, report.key_from_base) if report.skipped else poses
            particles = np.column_stack([now, np.exp(log_weights)]).astype(np.float32)
            alive = sorted({row for row in rows.values() if row != _DIED_OUT})
            past = {row: ancestry.trajectory(row)[:, :3] for row in alive}
            path = past[rows[BEST]][:, :2].astype(np.float32)
            ends = path[closures].reshape(-1, 4)  # corrections move them
            trunk, tree = thin_tree(ancestry)
            return Frame(path, tree, particles, ends, len(trunk), past)

        status = {
            "particles": len(poses),
            "best": state.best,
            "closures": len(found),
            "bytes": state.maps.nbytes,
            **self.find_again(state),
        }
        return StateView(maps, rows, state.maps.resolution_m, status, make_frame)

    def find_again(self, state: GridFastSlamState) -> dict[str, Any]:
        """Return whether the robot is looked for in the map of earlier drives ("searches"), and where it was "found".

        That is the key scan at which it was certain: its pose [x, y, theta], and how far the robot had driven then, m.
        """
        closure_state = state.closure_state
        if closure_state is None:
            return {}
        self._was_searched |= closure_state.earlier is not None
        if not self._was_searched or closure_state.joined < 0:
            return {"searches": closure_state.earlier is not None}
        first = len(closure_state.graph) - self._keys  # of this drive
        at = first + closure_state.joined_after
        if not 0 < first < at <= len(closure_state.graph):
            return {"searches": False}
        way_m = closure_state.driven_before_found_m(first)
        return {"searches": False, "found": {"pose": closure_state.graph.poses[at - 1].tolist(), "way_m": way_m}}

    def find_changes(self, state: GridFastSlamState, rows: dict[int, int]) -> dict[int, TileChanges]:
        """Return the changes of each channel's map since the last look; `rows` are the particles of the channels."""
        self._all_changed |= state.maps is not self._maps  # others since a correction, or a step that failed
        self._maps = state.maps
        written = None if self._all_changed else self._written_box()
        self._all_changed = False
        self._written = []
        return {
            channel: detector.find_changes(state.maps, rows[channel], written)
            for channel, detector in self._detectors.items()
            if rows[channel] != _DIED_OUT
        }

    def _written_box(self) -> Box | None:
        """Return the box in which maps may have changed since the last view; None if unknown."""
        if not self._written:
            return EMPTY_BOX
        reach = 0.0
        for _, scan in self._written:
            if scan is None:
                return None
            hits = scan.ranges[(scan.status == BeamStatus.HIT) & (scan.ranges < self._range_max_m)]
            reach = max(reach, float(hits.max(initial=0.0)) + float(np.hypot(*scan.geometry.origin)))
        return Box.around(np.concatenate([poses for poses, _ in self._written]), reach)


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
        self._poses = RowBuffer(3)

    def record(self, report: LocalizationReport, scan: LaserScan | None) -> None:
        """Record the pose at a scan, NaN if the robot is lost."""
        if report.skipped is None:
            self._poses.append(np.full((1, 3), np.nan) if report.lost else report.pose[None])

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Do nothing: all particles share one map."""

    def view(self, report: LocalizationReport, state: MonteCarloState) -> StateView:
        """Return a view of the current state."""
        past = self._poses.rows
        state = state.snapshot()

        def make_frame() -> Frame:
            """Return at most a thousand particles, predicted by odometry since the last update."""
            chosen, ratios = select_representatives(np.exp(state.log_weights))
            moved = between(state.estimate.pose, report.pose)
            poses = compose(state.poses[chosen], moved).astype(np.float32)
            rounded = np.rint(poses * _STEPS_PER_UNIT) / _STEPS_PER_UNIT
            cloud = np.column_stack([rounded, ratios]).astype(np.float32)
            return Frame(past[:, :2], particles=cloud, poses={0: past.astype(np.float64)})

        status = {
            "particles": report.particles,
            "looking": report.looking,
            "lost_probability": report.lost_probability,
            "inlier_ratio": report.inlier_ratio,
        }
        return StateView({}, {BEST: 0}, self._resolution_m, status, make_frame)


FilterMonitor: TypeAlias = MappingMonitor | LocalizationMonitor
"""Collects changes from a filter's reports and states; used by the filter's thread only."""


def _find_children(line: IntArray, parents: IntArray) -> IntArray:
    """Return the particles whose parent is one of `line`."""
    return np.flatnonzero(np.isin(parents, line))
