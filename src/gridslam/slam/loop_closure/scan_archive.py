"""Archive of scans for rebuilding maps and rematching after corrections."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry.single_pose import UNKNOWN_POSE, Pose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.serialization import NOT_SAVED
from gridslam.tracking.state import is_within
from gridslam.types import BeamEnds, FloatArray, IntArray, StoredScan

__all__ = ["ScanArchive"]

_STEPS = 32767
_NEAR_M = 0.02
_NEAR_RAD = 0.01
_BETWEEN_KEYS = 256
"""Of a laser with 1080 beams over 270 degrees 128, 256 and all of them gave the same trajectory, to 3 mm at worst."""
_MOST_BYTES = 32_000_000
"""45,000 scans of 180 beams."""

_NOTHING = -1
"""The place of a scan of which nothing is kept."""
_BARE = StoredScan(np.empty((0, 2)), np.zeros(2))
_NO_ENDS = np.empty((0, 2), np.int16)


@final
@dataclass(slots=True, eq=False)
class ScanArchive:
    """End points of the usable beams of each scan, 4 bytes a beam: in steps of the farthest one's 32,767th part.

    That is 1 mm where a laser sees 30 m. Key scans, from which maps are drawn, are kept whole. The others are only
    matched again, one by one: of them every k-th beam is kept, with the least k that leaves at most 256. Of one taken
    within 2 cm and 0.01 rad of the last one that was kept nothing is kept: it saw the same, and a robot that stands for
    hours would fill the memory. So would one that drives for hours: when all these come to more than 32 MB, only every
    second scan is kept from then on and from the beginning, later only every fourth.

    Attributes
    ----------
    keys : list of int
        Which scans are key scans.
    """

    keys: list[int] = field(default_factory=list)
    _count: int = 0
    _stored: Annotated[list[int], "E"] = field(default_factory=list)  # scans of which anything is kept, in their order
    _ends: Annotated[list[Annotated[NDArray[np.int16], None, 2]], "E"] = field(default_factory=list)
    _steps_m: Annotated[list[float], "E"] = field(default_factory=list)
    _origins: Annotated[list[Annotated[FloatArray, 2]], "E"] = field(default_factory=list)
    _last_stored_pose: Pose = UNKNOWN_POSE
    _storage_interval: int = 1  # every n-th scan between key scans is stored
    _between_bytes: int = field(init=False, metadata=NOT_SAVED)  # of the scans between key scans
    # of each scan its place in `_stored`
    _places: list[int] = field(init=False, default_factory=list, metadata=NOT_SAVED)

    def __post_init__(self) -> None:
        """Check what is given, and index it."""
        stored = np.array([-1, *self._stored, self._count])
        if (np.diff(stored) < 1).any() or not set(self.keys) <= set(self._stored):
            expected = f"ascending scans below {self._count}, the key scans among them"
            raise ArgumentError("stored", expected, f"{len(self._stored)} that are not")
        self._index()

    def append(self, beams: BeamEnds, pose: Pose, *, is_key: bool) -> None:
        """Append a scan from `pose` in a frame that drifts slowly."""
        scan = self._count
        ends = beams.ends
        self._count += 1
        self._places.append(_NOTHING)
        if is_key:
            self.keys.append(scan)
        elif (
            not len(ends)
            or scan % self._storage_interval
            or is_within(pose, self._last_stored_pose, _NEAR_M, _NEAR_RAD)
        ):
            return
        else:
            ends = ends[:: max(1, -(-len(ends) // _BETWEEN_KEYS))]
        step_m = float(np.abs(ends).max(initial=0.0)) / _STEPS or 1.0
        self._places[scan] = len(self._stored)
        self._stored.append(scan)
        self._ends.append(np.rint(ends / step_m).astype(np.int16))
        self._steps_m.append(step_m)
        self._origins.append(beams.origin)
        if len(ends):
            self._last_stored_pose = pose
        if not is_key:
            self._between_bytes += self._ends[-1].nbytes
        if self._between_bytes > _MOST_BYTES:
            self._thin_out()

    def __len__(self) -> int:
        """Return the number of scans."""
        return self._count

    def __getitem__(self, scan: int) -> StoredScan:
        """Scan number `scan`, from 0; without beams if nothing is kept of it."""
        place = self._places[scan]
        if place == _NOTHING:
            return _BARE
        return StoredScan(self._ends[place] * np.float64(self._steps_m[place]), self._origins[place])

    def key(self, key: int) -> StoredScan:
        """Key scan number `key`, from 0."""
        return self[self.keys[key]]

    def batch(self, scans: Sequence[int]) -> ScanBatch:
        """Scans by number, side by side; without beams those of which nothing is kept."""
        places = [self._places[scan] for scan in scans]
        stored = [_NO_ENDS if place == _NOTHING else self._ends[place] for place in places]
        counts = [len(ends) for ends in stored]
        starts = np.zeros(len(places) + 1, np.int64)
        np.cumsum(counts, out=starts[1:])
        steps_m = np.repeat([1.0 if place == _NOTHING else self._steps_m[place] for place in places], counts)
        whole = np.concatenate([*stored, _NO_ENDS])
        origins = [_BARE.origin if place == _NOTHING else self._origins[place] for place in places]
        return ScanBatch(np.multiply(whole, steps_m[:, None], dtype=np.float64), starts, np.reshape(origins, (-1, 2)))

    @property
    def nbytes(self) -> int:
        """Bytes of the end points."""
        return sum(ends.nbytes for ends in self._ends)

    def extend(self, later: ScanArchive) -> None:
        """Append the scans of another archive, which follow those of this one."""
        first = self._count
        self._places += [place if place == _NOTHING else len(self._stored) + place for place in later._places]
        self.keys += [first + key for key in later.keys]
        self._count += later._count
        self._stored += [first + scan for scan in later._stored]
        self._ends += later._ends
        self._steps_m += later._steps_m
        self._origins += later._origins
        self._last_stored_pose = later._last_stored_pose
        self._storage_interval = max(self._storage_interval, later._storage_interval)
        self._between_bytes += later._between_bytes

    def select(self, scans: IntArray, bare: IntArray) -> ScanArchive:
        """Another archive of some scans (N,), ascending, numbered from 0; of those in `bare` (M,) nothing is kept."""
        number = {scan: place for place, scan in enumerate(scans.tolist())}
        kept = number.keys() - set(bare.tolist())
        stored = [place for place, scan in enumerate(self._stored) if scan in kept]
        return replace(
            self,
            keys=[number[key] for key in self.keys if key in number],
            _count=len(number),
            _stored=[number[self._stored[place]] for place in stored],
            _ends=[self._ends[place] for place in stored],
            _steps_m=[self._steps_m[place] for place in stored],
            _origins=[self._origins[place] for place in stored],
        )

    def truncate(self, scans: int, key_scans: int) -> None:
        """Forget all but the first scans, of which `key_scans` are key scans."""
        del self.keys[key_scans:]
        self._count = scans
        self._last_stored_pose = UNKNOWN_POSE  # so the next scan is kept
        self._keep(range(bisect_left(self._stored, scans)))

    def snapshot(self) -> ScanArchive:
        """Keep a copy for later; the scans themselves, which never change, are shared."""
        twin = copy(self)
        twin.keys = self.keys.copy()
        twin._stored = self._stored.copy()
        twin._ends = self._ends.copy()
        twin._steps_m = self._steps_m.copy()
        twin._origins = self._origins.copy()
        twin._places = self._places.copy()
        return twin

    def _thin_out(self) -> None:
        """Keep half as many of the scans that are no key scans."""
        self._storage_interval *= 2
        keys = set(self.keys)
        interval = self._storage_interval
        self._keep([place for place, scan in enumerate(self._stored) if not scan % interval or scan in keys])

    def _keep(self, places: Sequence[int]) -> None:
        """Forget all stored scans but those at these places."""
        self._stored = [self._stored[place] for place in places]
        self._ends = [self._ends[place] for place in places]
        self._steps_m = [self._steps_m[place] for place in places]
        self._origins = [self._origins[place] for place in places]
        self._index()

    def _index(self) -> None:
        """Find the place of each scan, and count the bytes of those between key scans."""
        places = np.full(self._count, _NOTHING)
        places[np.array(self._stored, np.int64)] = np.arange(len(self._stored))
        self._places = places.tolist()
        self._between_bytes = self.nbytes - sum(self._ends[self._places[key]].nbytes for key in self.keys)
