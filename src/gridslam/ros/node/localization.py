"""The node in a known map: Monte Carlo localization, a replacement for map_server and AMCL."""

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
    MonteCarloConfiguration,
    MonteCarloLocalization,
    MonteCarloState,
)  # fmt: skip
from gridslam.pipeline import run
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.ros.node.messages import GridMessage
from gridslam.ros.node.recording import ScanRecorder
from gridslam.ros.node.rendering import map_cells
from gridslam.types import FloatArray, LaserScan, Odometry

__all__ = ["KnownMapPublisher", "Localization", "LocalizationSession"]

InitialPose = tuple[FloatArray, FloatArray] | None
"""A pose (3,) and its covariance (3, 3); None if the pose is unknown."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """Map, filter and initial pose of a localization.

    Attributes
    ----------
    known : KnownMap
        The map.
    configuration : MonteCarloConfiguration
        Configuration of the filter.
    initial_pose : (pose (3,), covariance (3, 3)) or None
        Initial pose; None: global localization.
    """

    known: KnownMap
    configuration: MonteCarloConfiguration
    initial_pose: InitialPose = None

    @property
    def range_max_m(self) -> float:
        """Range from which beams are ignored, m."""
        return self.configuration.range_max_m


@final
class LocalizationSession:
    """A localization session, from its first scan to a jump of time or the end; used by the filter's thread only.

    Parameters
    ----------
    localization : Localization
        Map and filter.
    seed : int
        Seed of the filter.
    record : Path or None
        File for the accepted scans.
    """

    restart_message = "localization restarts"

    def __init__(self, localization: Localization, seed: int, record: Path | None) -> None:
        self._localization = localization
        self._rng = np.random.default_rng(seed)
        self._mcl = MonteCarloLocalization(localization.known, localization.configuration)
        self._recorder = None if record is None else ScanRecorder(record)
        self.set_pose(localization.initial_pose)

    def set_pose(self, pose: InitialPose) -> None:
        """Set the pose from the next scan on; None: the pose is unknown."""
        self.state: MonteCarloState = self._mcl.init() if pose is None else self._mcl.init_gaussian(*pose, self._rng)

    def add(self, accepted: AcceptedScan) -> None:
        """Record a measurement before the filter processes it; raises OutputError if it cannot be recorded."""
        if self._recorder is not None:
            self._recorder.add(accepted)

    def run(self, source: Iterator[Measurement], observers: Sequence[Callable[[Any, Any, float], None]]) -> None:
        """Run the filter on all measurements of a source."""
        run(source, self, rng=self._rng, observers=observers, state=self.state)

    def step(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Process a measurement from the session's own state, which `set_pose` may have changed since the last scan."""
        self.state, report = self._mcl.step(self.state, odometry, scan, rng)
        return self.state, report

    def copy(self) -> None:
        """Raise ArgumentError: a localization has no map to save."""
        raise ArgumentError("save", "a node that maps", "one that localizes; `gridslam localize` takes its record")

    def close(self) -> None:
        """Close the record."""
        if self._recorder is not None:
            self._recorder.close()


@final
class KnownMapPublisher:
    """Publishes the known map once; otherwise behaves like a `MapRenderer` that is always busy.

    Parameters
    ----------
    localization : Localization
        Provides the map.
    values : str
        As for `map_cells`.
    frame : str
        Frame of the map.
    publish : callable
        Publishes the map.
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
        """Do nothing: the map does not change."""
        return 0

    def reset(self) -> None:
        """Do nothing: the map does not change."""

    def close(self) -> None:
        """Do nothing: there is no thread."""
