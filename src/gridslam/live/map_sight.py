"""What there is to see of a filter that maps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.live.scene import NO_CLOSURES, Float32Array, Tree, tree_of
from gridslam.live.sight import BEST, CORRECTED, View
from gridslam.live.tiles import NOWHERE, Box, TileChanges, TileWatch
from gridslam.particles.ancestry import Ancestry
from gridslam.slam.state import GridFastSlamState
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan, StepReport

__all__ = ["MapSight"]

_DIED_OUT = -1
_REMEMBERED = 256  # resamplings


@final
class MapSight:
    """Of a filter that maps.

    Parameters
    ----------
    range_max_m : float, m
        Beams of this range or more write nothing; infinite if it is not known.
    """

    def __init__(self, range_max_m: float) -> None:
        """Begin before the first scan."""
        self._range_max_m = range_max_m
        self.begin()

    def begin(self) -> None:
        """Begin before the first scan, with other maps than those looked at until now."""
        self._everything, self._keys = True, 0
        self._written: list[tuple[FloatArray, LaserScan | None]] = []
        self._closures: list[tuple[int, int]] = []
        self._resamplings: deque[tuple[int, IntArray]] = deque(maxlen=_REMEMBERED)
        self._watches = {BEST: TileWatch()}
        self._lines: dict[int, IntArray] = {}  # of each channel the particles that continue the chosen one

    def note(self, report: StepReport, scan: LaserScan | None) -> int:
        """Record a scan; return `CORRECTED` if the trajectory was corrected."""
        self._closures += report.closures
        if report.skipped is not None:
            return 0
        self._keys += 1
        self._everything |= report.corrected
        if report.poses is not None:
            self._written.append((report.poses, scan))
        if report.parents is not None:
            self._resamplings.append((self._keys, report.parents))
            self._lines = {channel: _children(line, report.parents) for channel, line in self._lines.items()}
        return CORRECTED * report.corrected

    def watch(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle and of who continues it; no longer if it is -1."""
        if particle < 0:
            self._watches.pop(channel, None)
            self._lines.pop(channel, None)
            return
        line = np.array([particle])
        for key, parents in self._resamplings:
            if key > keys:
                line = _children(line, parents)
        self._watches[channel], self._lines[channel] = TileWatch(), line

    def look(self, report: StepReport, state: GridFastSlamState) -> View:
        """See the state as it is now, and what of the maps has changed since the last look."""
        rows = {channel: int(line[0]) if len(line) else _DIED_OUT for channel, line in self._lines.items()}
        rows[BEST] = state.best
        written = None if self._everything else self._box()
        maps = {
            channel: watch.look(state.maps, rows[channel], written)
            for channel, watch in self._watches.items()
            if rows[channel] != _DIED_OUT
        }
        self._everything, self._written = False, []
        return _MapView(
            maps, rows, state.maps.resolution_m, state.maps.nbytes, report, state.poses, state.log_weights,
            state.ancestry.snapshot(), np.array(self._closures, np.int64).reshape(-1, 2),
        )  # fmt: skip

    def _box(self) -> Box | None:
        """Where maps were written to since the last look."""
        if not self._written:
            return NOWHERE
        reach = 0.0
        for _, scan in self._written:
            if scan is None:
                return None
            hits = scan.ranges[(scan.status == BeamStatus.HIT) & (scan.ranges < self._range_max_m)]
            reach = max(reach, float(hits.max(initial=0.0)) + float(np.hypot(*scan.geometry.origin)))
        return Box.about(np.concatenate([poses for poses, _ in self._written]), reach)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _MapView:
    maps: dict[int, TileChanges]
    rows: dict[int, int]
    resolution_m: float
    nbytes: int
    report: StepReport
    poses: FloatArray
    log_weights: FloatArray
    ancestry: Ancestry
    pairs: IntArray  # of key scans that show one place

    def particles(self) -> Float32Array:
        now = compose(self.poses, self.report.key_from_base) if self.report.skipped else self.poses
        return np.column_stack([now, np.exp(self.log_weights)]).astype(np.float32)

    def past(self) -> tuple[Float32Array, Tree]:
        return tree_of(self.ancestry)

    def closures(self) -> Float32Array:
        """Where they are as the best particle has it; they move when the past is corrected."""
        if not len(self.pairs):
            return NO_CLOSURES
        places = self.ancestry.trajectory(self.rows[BEST])[:, :2]
        return places[self.pairs].reshape(-1, 4).astype(np.float32)

    def facts(self) -> dict[str, Any]:
        count, closures = len(self.poses), len(self.pairs)
        return {"particles": count, "best": self.rows[BEST], "closures": closures, "bytes": self.nbytes}


def _children(line: IntArray, parents: IntArray) -> IntArray:
    """The particles that continue one of `line`."""
    return np.flatnonzero(np.isin(parents, line))
