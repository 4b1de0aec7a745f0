"""What filters let the page see: looked at by the filter's thread, worked out by the server's.

SLAM and localization tell the page the same things; what one of them does not have (pasts, closures, maps of its own)
is empty there.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, Protocol, TypeVar

from gridslam.live.scene import AncestryTree, Float32Array
from gridslam.live.tiles import TileChanges
from gridslam.types import FloatArray, LaserScan

__all__ = ["BEST", "CORRECTED", "LOST", "FilterMonitor", "ScanReport", "StateView"]

BEST = 0
"""The channel that shows the best particle's map, whichever that is."""
LOST, CORRECTED = 1, 8
"""Flags of a key scan: the robot was lost (as in a record); the past was corrected after it."""

R = TypeVar("R", contravariant=True)
S = TypeVar("S", contravariant=True)


class ScanReport(Protocol):
    """What the reports of all filters tell of one scan; attributes as of `gridslam.types.StepReport`."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the scan."""

    @property
    def pose(self) -> FloatArray:
        """Where the robot is, (3,)."""

    @property
    def covariance(self) -> FloatArray:
        """Of the pose, (3, 3)."""

    @property
    def lost(self) -> bool:
        """Whether the pose is a guess."""

    @property
    def n_eff(self) -> float:
        """Effective sample size."""

    @property
    def skipped(self) -> Enum | None:
        """Why the particles took no step."""

    @property
    def poses(self) -> FloatArray | None:
        """The particles (N, 3) where they took a step."""


class StateView(Protocol):
    """What can be seen of a state; its methods are called by the server's thread, and see the state as it was."""

    @property
    def maps(self) -> dict[int, TileChanges]:
        """What has changed in the map of each channel."""

    @property
    def rows(self) -> dict[int, int]:
        """The particle of each channel; -1 where its line has died out."""

    @property
    def resolution_m(self) -> float:
        """Side of a cell of the maps."""

    def particles(self) -> Float32Array:
        """Those that are shown, (K, 4): x m, y m, theta rad and weight."""

    def path_and_tree(self) -> tuple[Float32Array, AncestryTree]:
        """The way (T, 2) as far as all particles agree, and where they do not."""

    def closures(self) -> Float32Array:
        """The two places x, y that each loop closure joins, (C, 4), m."""

    def status(self) -> dict[str, Any]:
        """What else the page tells, as JSON values; ``particles``, how many there are, among it."""


class FilterMonitor(Protocol[R, S]):
    """Looks at a filter's reports and states; belongs to the filter's thread."""

    def reset(self) -> None:
        """Begin before the first scan."""

    def record(self, report: R, scan: LaserScan | None) -> int:
        """Take note of a scan; gives flags beside `LOST`."""

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle and of who continues it (see `LiveObserver.show_particle`)."""

    def view(self, report: R, state: S) -> StateView:
        """See the state as it is now, and what has changed since the last look."""
