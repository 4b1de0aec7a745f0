"""Monitor of a filter that maps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.live.monitor import BEST, CORRECTED, StateView
from gridslam.live.scene import NO_CLOSURES, AncestryTree, Float32Array, thin_tree
from gridslam.live.tiles import EMPTY_BOX, Box, TileChangeDetector, TileChanges
from gridslam.particles.ancestry import Ancestry
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan, StepReport

__all__ = ["MappingMonitor"]

_DIED_OUT = -1
_MAX_RESAMPLINGS = 256  # resamplings


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
        self._all_changed, self._keys = True, 0
        self._written: list[tuple[FloatArray, LaserScan | None]] = []
        self._closures: list[tuple[int, int]] = []
        self._resamplings: deque[tuple[int, IntArray]] = deque(maxlen=_MAX_RESAMPLINGS)
        self._detectors = {BEST: TileChangeDetector()}
        self._lines: dict[int, IntArray] = {}  # of each channel the descendants of the selected particle

    def record(self, report: StepReport, scan: LaserScan | None) -> int:
        """Record a scan; return `CORRECTED` if the trajectory was corrected."""
        self._closures += report.closures
        if report.skipped is not None:
            return 0
        self._keys += 1
        self._all_changed |= report.corrected
        if report.poses is not None:
            self._written.append((report.poses, scan))
        if report.parents is not None:
            self._resamplings.append((self._keys, report.parents))
            self._lines = {channel: _find_children(line, report.parents) for channel, line in self._lines.items()}
        return CORRECTED * report.corrected

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
        self._detectors[channel], self._lines[channel] = TileChangeDetector(), line

    def view(self, report: StepReport, state: GridFastSlamState) -> StateView:
        """Return a view of the current state, with all changes of the maps since the last view."""
        rows = {channel: int(line[0]) if len(line) else _DIED_OUT for channel, line in self._lines.items()}
        rows[BEST] = state.best
        written = None if self._all_changed else self._written_box()
        maps = {
            channel: detector.find_changes(state.maps, rows[channel], written)
            for channel, detector in self._detectors.items()
            if rows[channel] != _DIED_OUT
        }
        self._all_changed, self._written = False, []
        return _MappingView(
            maps, rows, state.maps.resolution_m, state.maps.nbytes, report, state.poses, state.log_weights,
            state.ancestry.snapshot(), np.array(self._closures, np.int64).reshape(-1, 2),
        )  # fmt: skip

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
@dataclass(frozen=True, slots=True, eq=False)
class _MappingView:
    maps: dict[int, TileChanges]
    rows: dict[int, int]
    resolution_m: float
    nbytes: int
    report: StepReport
    poses: FloatArray
    log_weights: FloatArray
    ancestry: Ancestry
    pairs: IntArray  # of key scans at the same place

    def particles(self) -> Float32Array:
        now = compose(self.poses, self.report.key_from_base) if self.report.skipped else self.poses
        return np.column_stack([now, np.exp(self.log_weights)]).astype(np.float32)

    def path_and_tree(self) -> tuple[Float32Array, AncestryTree]:
        return thin_tree(self.ancestry)

    def closures(self) -> Float32Array:
        """Return the end points of the closures on the best particle's path, which corrections move."""
        if not len(self.pairs):
            return NO_CLOSURES
        positions = self.ancestry.trajectory(self.rows[BEST])[:, :2]
        return positions[self.pairs].reshape(-1, 4).astype(np.float32)

    def status(self) -> dict[str, Any]:
        count, closures = len(self.poses), len(self.pairs)
        return {"particles": count, "best": self.rows[BEST], "closures": closures, "bytes": self.nbytes}


def _find_children(line: IntArray, parents: IntArray) -> IntArray:
    """Return the particles whose parent is one of `line`."""
    return np.flatnonzero(np.isin(parents, line))
