"""Interface between filters and the page: sampled in the filter's thread, rendered in the server's.

SLAM and localization send the same data to the page; what one of them does not have (pasts, closures, maps of its own)
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
"""The channel that always shows the map of the best particle."""
LOST, CORRECTED = 1, 8
"""Flags of a key scan: the robot was lost (as in a record); a correction of the trajectory followed."""

R = TypeVar("R", contravariant=True)
S = TypeVar("S", contravariant=True)


class ScanReport(Protocol):
    """Common attributes of the reports of all filters, as in `gridslam.types.StepReport`."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the scan."""

    @property
    def pose(self) -> FloatArray:
        """Pose of the robot, (3,)."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the pose, (3, 3)."""

    @property
    def lost(self) -> bool:
        """Whether the robot is lost."""

    @property
    def n_eff(self) -> float:
        """Effective sample size."""

    @property
    def skipped(self) -> Enum | None:
        """Why the particles were not updated; None if they were."""

    @property
    def poses(self) -> FloatArray | None:
        """Poses (N, 3) of the particles; None if they were not updated."""


class StateView(Protocol):
    """An immutable view of a filter's state; its methods are called in the server's thread."""

    @property
    def maps(self) -> dict[int, TileChanges]:
        """Changed tiles of the map of each channel."""

    @property
    def rows(self) -> dict[int, int]:
        """Particle of each channel; -1 if it has no descendants."""

    @property
    def resolution_m(self) -> float:
        """Side of the maps' cells, m."""

    def particles(self) -> Float32Array:
        """Return the displayed particles (K, 4): x m, y m, theta rad and weight."""

    def path_and_tree(self) -> tuple[Float32Array, AncestryTree]:
        """Return the path (T, 2) that all particles share, and the tree of their differing paths."""

    def closures(self) -> Float32Array:
        """Return the end points x, y of each loop closure, (C, 4), m."""

    def status(self) -> dict[str, Any]:
        """Further values for the page, as JSON values; including ``particles``, their number."""


class FilterMonitor(Protocol[R, S]):
    """Collects what changes from a filter's reports and states; used by the filter's thread only."""

    def reset(self) -> None:
        """Start before the first scan."""

    def record(self, report: R, scan: LaserScan | None) -> int:
        """Record a scan; returns flags such as `LOST`."""

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle and its descendants (see `LiveObserver.show_particle`)."""

    def view(self, report: R, state: S) -> StateView:
        """Return a view of the current state, with all changes since the last view."""
