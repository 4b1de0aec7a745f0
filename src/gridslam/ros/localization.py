"""What the node does in a known map: Monte Carlo localization, in the place of map_server and AMCL."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.io.measurement import Measurement
from gridslam.localization import (
    KnownMap,
    LocalizationReport,
    MonteCarloLocalization,
    MonteCarloParts,
    MonteCarloState,
)  # fmt: skip
from gridslam.pipeline import run
from gridslam.ros.accepted_scan import AcceptedScan
from gridslam.ros.messages import GridMessage
from gridslam.ros.recording import ScanRecorder
from gridslam.ros.rendering import map_cells
from gridslam.types import FloatArray, LaserScan, Odometry

__all__ = ["KnownMapPublisher", "Localization", "LocalizationSession"]

InitialPose = tuple[FloatArray, FloatArray] | None
"""A pose (3,) and its covariance (3, 3); None where nothing is known."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """What decides how the robot is localized.

    Attributes
    ----------
    known : KnownMap
        Where it is.
    parts : MonteCarloParts
        Of the filter.
    initial_pose : (pose (3,), covariance (3, 3)) or None
        Where it is at first; it is found where that is not known.
    """

    known: KnownMap
    parts: MonteCarloParts
    initial_pose: InitialPose = None

    @property
    def range_max_m(self) -> float:
        """Range from which on beams are not used, m."""
        return self.parts.range_max_m


@final
class LocalizationSession:
    """From its first scan until time jumps back or the end; belongs to the filter's thread.

    Parameters
    ----------
    localization : Localization
        Map and filter.
    seed : int
        Of the filter.
    record : Path or None
        Where its accepted scans are recorded, to be localized again.
    """

    restart_message = "localization begins anew"

    def __init__(self, localization: Localization, seed: int, record: Path | None) -> None:
        self._localization = localization
        self._rng = np.random.default_rng(seed)
        self._mcl = MonteCarloLocalization(localization.known, localization.parts)
        self._recorder = None if record is None else ScanRecorder(record)
        self.set_pose(localization.initial_pose)

    def set_pose(self, pose: InitialPose) -> None:
        """Let the robot be somewhere else from the next scan on; nowhere that is known, if None."""
        self.state: MonteCarloState = self._mcl.init() if pose is None else self._mcl.around(*pose, self._rng)

    def add(self, accepted: AcceptedScan) -> None:
        """Take note of a measurement, before the filter does; raises OutputError where it cannot be recorded."""
        if self._recorder is not None:
            self._recorder.add(accepted)

    def run(self, source: Iterator[Measurement], observers: Sequence[Callable[[Any, Any, float], None]]) -> None:
        """Take all measurements of a source, one after the other."""
        run(source, self, rng=self._rng, observers=observers, state=self.state)

    def step(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Take one measurement from the session's own state, which `set_pose` may have changed since the last one."""
        self.state, report = self._mcl.step(self.state, odometry, scan, rng)
        return self.state, report

    def copy(self) -> None:
        """Raise ArgumentError: there is no map of one's own to be saved."""
        raise ArgumentError("save", "a node that maps", "one that localizes; `gridslam localize` takes its record")

    def close(self) -> None:
        """End the record."""
        if self._recorder is not None:
            self._recorder.close()


@final
class KnownMapPublisher:
    """Publishes the known map, once; to the rest of the node it is like a `MapRenderer` that is always at work.

    Parameters
    ----------
    localization : Localization
        Of which the map is.
    values : str
        As of `map_cells`.
    frame : str
        Of the map.
    publish : callable
        Takes the map.
    """

    is_idle = False

    def __init__(
        self,
        localization: Localization,
        values: Literal["trinary", "probability"],
        frame: str,
        publish: Callable[[GridMessage], None],
    ) -> None:
        grid = localization.known.grid
        x, y = (float(value) for value in grid.origin)
        self.latest = GridMessage(0, frame, grid.resolution_m, (x, y), map_cells(grid, values))
        self._publish = publish

    def start(self, stamp_ns: int) -> None:
        """Publish the map."""
        self.latest = self.latest._replace(stamp_ns=stamp_ns)
        self._publish(self.latest)

    def render(self, state: Any, stamp_ns: int) -> int:  # noqa: ANN401
        """Draw nothing."""
        return 0

    def reset(self) -> None:
        """Forget nothing."""

    def close(self) -> None:
        """End nothing."""
