"""Drives: metadata of the mapped logs of a session."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from typing import final

import numpy as np

from gridslam.arguments import require_instance
from gridslam.io.log_statistics import LogStatistics
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectories
from gridslam.slam.full_slam.thinning import thin_piece
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.types import FloatArray, IntArray, Trajectory


@final
@dataclass(frozen=True, slots=True)
class DrivenLog:
    """A log that was mapped.

    Attributes
    ----------
    path : str
        Where it was.
    sha256 : str
        Its digest; empty for measurements that came from no file.
    scans : int
        Number of its scans.
    first_stamp_ns, last_stamp_ns : int, ns
        Stamps of the first and of the last one.
    length_m : float, m
        Length of the path of its odometry.
    """

    path: str
    sha256: str
    scans: int
    first_stamp_ns: int
    last_stamp_ns: int
    length_m: float

    def __post_init__(self) -> None:
        """Check the values; raises ArgumentError."""
        for name in ("path", "sha256"):
            require_instance(name, getattr(self, name), str)
        for name in ("scans", "first_stamp_ns", "last_stamp_ns"):
            require_instance(name, getattr(self, name), int)
        require_instance("length_m", self.length_m, int, float)

    @classmethod
    def of(cls, path: str, digest: str, log: LogStatistics) -> DrivenLog:
        """Describe a log that was read."""
        stamps_ns = log.first_stamp_ns or 0, log.last_stamp_ns or 0
        return cls(path, digest, log.scan_count, *stamps_ns, log.odometry_length_m)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The path of one robot without being moved in between: one log, or several that continue each other.

    Attributes
    ----------
    name : str
        Of the robot, or of the first log.
    logs : tuple of DrivenLog
        In their order.
    stamps_ns : (N,) int64, ns
        Of all scans.
    scans : TrackedScans
        The scans as they were tracked; key scans are counted over the piece.
    """

    name: str
    logs: tuple[DrivenLog, ...]
    stamps_ns: IntArray
    scans: TrackedScans

    def __repr__(self) -> str:
        """Return one line."""
        return f"Drive({self.name}: {len(self.stamps_ns)} scans of {len(self.logs)} log{'s' * (len(self.logs) != 1)})"

    @property
    def key_stamps_ns(self) -> IntArray:
        """Stamps of its key scans."""
        return np.asarray(self.stamps_ns[np.flatnonzero(np.diff(self.scans.keys, prepend=-1))])


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedPiece:
    """A piece of the map and its drives, in the order of their key scans.

    Attributes
    ----------
    piece : MapPiece
        Key scans and graph.
    drives : tuple of Drive
        At least one.
    """

    piece: MapPiece
    drives: tuple[Drive, ...]

    def __repr__(self) -> str:
        """Return one line."""
        return f"SavedPiece({', '.join(drive.name for drive in self.drives)}: {self.piece})"

    @property
    def name(self) -> str:
        """Name of its map: that of its first drive."""
        return self.drives[0].name

    @property
    def tracked_scans(self) -> list[TrackedScans]:
        """The scans of all drives."""
        return [drive.scans for drive in self.drives]

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The trajectory of each drive by its name, in the frame of the piece's map."""
        own = self.split(full_trajectories(self.piece.poses, self.tracked_scans))
        return {drive.name: Trajectory(drive.stamps_ns, own[drive.name]) for drive in self.drives}

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of the scans of all drives, one drive after the other."""
        return np.concatenate([drive.stamps_ns for drive in self.drives])

    def thin(self, mapper: OccupancyGridMapping) -> SavedPiece:
        """Remove the parts that newer drives have seen (see `thin_piece`), and drives of which nothing remains."""
        thinned = thin_piece(self.piece, self.tracked_scans, mapper)
        stamps = self.stamps_ns[thinned.scans]
        own = np.split(stamps, np.cumsum([len(scans.keys) for scans in thinned.drives])[:-1])
        drives = (
            replace(drive, stamps_ns=stamps_ns, scans=scans)
            for drive, stamps_ns, scans in zip(self.drives, own, thinned.drives, strict=False)
            if len(scans.keys)
        )
        return SavedPiece(thinned.piece, tuple(drives))

    def freeze(self, poses: FloatArray) -> SavedPiece:
        """Return the same piece, its key scans frozen, and all its scans at poses (N, 3)."""
        own = self.split(poses).values()
        drives = (
            replace(drive, scans=drive.scans._replace(poses=there))
            for drive, there in zip(self.drives, own, strict=True)
        )
        return SavedPiece(self.piece.freeze(), tuple(drives))

    def split(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Split an array with a row for each scan of all drives, by the drives' names."""
        ends = np.cumsum([len(drive.stamps_ns) for drive in self.drives])[:-1]
        return {drive.name: own for drive, own in zip(self.drives, np.split(rows, ends), strict=True)}


def choose_name(name: str, others: Sequence[str]) -> str:
    """Give a name that no other drive has: `name`, or with the first number from 2 on that is free."""
    names = chain([name], (f"{name}_{number}" for number in count(2)))
    return next(free for free in names if free not in others)


def choose_names(names: Iterable[str]) -> list[str]:
    """Give each of several names as `choose_name` does: one that is repeated gets a number."""
    chosen: list[str] = []
    for name in names:
        chosen.append(choose_name(name, chosen))
    return chosen
