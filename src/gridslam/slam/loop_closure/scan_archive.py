"""Archive of scans for rebuilding maps and rematching after corrections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam import serialization
from gridslam.arguments import Limits
from gridslam.errors import ArgumentError
from gridslam.geometry.single_pose import UNKNOWN_POSE, Pose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.slam.loop_closure.rows import Rows
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
_BLOCK_ENDS = 1 << 18
"""A block has room for 1 MB of end points; what is not written yet takes no memory."""
_MOST_SCANS = 100_000_000
"""Of a saved archive: a month at 40 Hz."""

_NOTHING: Final = -1
"""The place of a scan of which nothing is kept."""
_BARE = StoredScan(np.empty((0, 2)), np.zeros(2))
_NO_ENDS = np.empty((0, 2), np.int16)
_END_BYTES = 4


@final
@dataclass(frozen=True, slots=True)
class _SavedScans:
    """An archive as it is saved; `E` scans are stored."""

    keys: list[int]
    count: Annotated[int, Limits(0, _MOST_SCANS)]
    stored: Annotated[IntArray, "E"]
    ends: Annotated[list[Annotated[NDArray[np.int16], None, 2]], "E"]
    steps_m: Annotated[FloatArray, "E"]
    origins: Annotated[FloatArray, "E", 2, Limits(-1e3, 1e3)]
    last_stored_pose: Pose
    storage_interval: Annotated[int, Limits(1, 1 << 31)]


@final
class ScanArchive:
    """End points of the usable beams of each scan, 4 bytes a beam: in steps of the farthest one's 32,767th part.

    That is 1 mm where a laser sees 30 m. Key scans, from which maps are drawn, are kept whole. The others are only
    matched again, one by one: of them every k-th beam is kept, with the least k that leaves at most 256. Of one taken
    within 2 cm and 0.01 rad of the last one that was kept nothing is kept: it saw the same, and a robot that stands for
    hours would fill the memory. So would one that drives for hours: when all these come to more than 32 MB, only every
    second scan is kept from then on and from the beginning, later only every fourth.

    End points of many scans share a block of memory, which the system takes back as a whole.

    Attributes
    ----------
    keys : list of int
        Which scans are key scans.
    """

    __slots__ = (
        *("_between_bytes", "_blocks", "_extents", "_frames", "_last_stored_pose", "_places", "_room"),
        *("_storage_interval", "keys"),
    )

    def __init__(self) -> None:
        self.keys: list[int] = []
        self._places = Rows[np.int32](1, np.int32)  # of each scan in the tables of those that are stored
        self._extents = Rows[np.int32](3, np.int32)  # block, first end in it, number of ends
        self._frames = Rows[np.float64](3, np.float64)  # length of a step (m), the laser's x and y in the base frame
        self._blocks: list[NDArray[np.int16]] = [_NO_ENDS]
        self._room = 0  # ends for which the last block has room
        self._last_stored_pose = UNKNOWN_POSE
        self._storage_interval = 1  # every n-th scan between key scans is stored
        self._between_bytes = 0  # of the scans between key scans

    def append(self, beams: BeamEnds, pose: Pose, *, is_key: bool) -> None:
        """Append a scan from `pose` in a frame that drifts slowly."""
        scan = len(self._places)
        ends = beams.ends
        if not is_key and (
            not len(ends)
            or scan % self._storage_interval
            or is_within(pose, self._last_stored_pose, _NEAR_M, _NEAR_RAD)
        ):
            self._places.append(_NOTHING)
            return
        if not is_key:
            ends = ends[:: max(1, -(-len(ends) // _BETWEEN_KEYS))]
        self._places.append(len(self._extents))
        step_m = float(np.abs(ends).max(initial=0.0)) / _STEPS or 1.0
        self._frames.append((step_m, *beams.origin))
        self._write(ends / step_m)
        if len(ends):
            self._last_stored_pose = pose
        if is_key:
            self.keys.append(scan)
        else:
            self._between_bytes += _END_BYTES * len(ends)
        if self._between_bytes > _MOST_BYTES:
            self._thin_out()

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._places)

    def __getitem__(self, scan: int) -> StoredScan:
        """Scan number `scan`, from 0; without beams if nothing is kept of it."""
        place = int(self._places.array[scan, 0])
        if place == _NOTHING:
            return _BARE
        block, first, count = self._extents.array[place].tolist()
        frame = self._frames.array[place]
        return StoredScan(self._blocks[block][first : first + count] * frame[0], frame[1:].copy())

    def key(self, key: int) -> StoredScan:
        """Key scan number `key`, from 0."""
        return self[self.keys[key]]

    def batch(self, scans: Sequence[int]) -> ScanBatch:
        """Scans by number, side by side; without beams those of which nothing is kept."""
        places = self._places.array[np.array(scans, np.int64), 0]
        is_kept = places != _NOTHING
        kept = places[is_kept]
        frames = np.zeros((len(places), 3))
        frames[is_kept] = self._frames.array[kept]
        counts = np.zeros(len(places), np.int64)
        counts[is_kept] = self._extents.array[kept, 2]
        starts = np.zeros(len(places) + 1, np.int64)
        np.cumsum(counts, out=starts[1:])
        whole = np.concatenate([*self._steps_at(kept), _NO_ENDS])
        steps_m = np.repeat(frames[:, 0], counts)
        return ScanBatch(np.multiply(whole, steps_m[:, None], dtype=np.float64), starts, frames[:, 1:].copy())

    @property
    def nbytes(self) -> int:
        """Bytes of the end points."""
        return _END_BYTES * int(self._extents.array[:, 2].sum())

    def extend(self, later: ScanArchive) -> None:
        """Append the scans of another archive, which follow those of this one."""
        places = later._places.array
        self.keys += [len(self) + key for key in later.keys]
        self._places.extend(np.where(places == _NOTHING, places, places + np.int32(len(self._extents))))
        self._extents.extend(later._extents.array + np.array([len(self._blocks), 0, 0], np.int32))
        self._frames.extend(later._frames.array)
        self._blocks += later._blocks
        self._room = 0  # it is the other archive that writes there
        self._last_stored_pose = later._last_stored_pose
        self._storage_interval = max(self._storage_interval, later._storage_interval)
        self._between_bytes += later._between_bytes

    def select(self, scans: IntArray, bare: IntArray) -> ScanArchive:
        """Another archive of some scans (N,), ascending, numbered from 0; of those in `bare` (M,) nothing is kept."""
        number = {scan: place for place, scan in enumerate(scans.tolist())}
        selected = self.snapshot()
        selected.keys = [number[key] for key in self.keys if key in number]
        places = self._places.array[scans, 0]
        selected._keep(np.where(np.isin(scans, bare), _NOTHING, places))
        return selected

    def truncate(self, scans: int, key_scans: int) -> None:
        """Forget all but the first scans, of which `key_scans` are key scans."""
        if scans == len(self):
            return
        del self.keys[key_scans:]
        self._places.truncate(scans)
        stored = int(self._places.array.max(initial=_NOTHING)) + 1
        self._extents.truncate(stored)
        self._frames.truncate(stored)
        self._last_stored_pose = UNKNOWN_POSE  # so the next scan is kept
        self._between_bytes = self._count_between()

    def snapshot(self) -> ScanArchive:
        """Keep a copy for later; the end points themselves, which never change, are shared."""
        twin = ScanArchive()
        twin.keys = self.keys.copy()
        twin._places = self._places.copy()
        twin._extents = self._extents.copy()
        twin._frames = self._frames.copy()
        twin._blocks = self._blocks.copy()  # it begins a block of its own: this archive goes on in the last one
        twin._last_stored_pose = self._last_stored_pose
        twin._storage_interval = self._storage_interval
        twin._between_bytes = self._between_bytes
        return twin

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays, from which `from_arrays` restores an identical archive."""
        stored = np.flatnonzero(self._places.array[:, 0] != _NOTHING)
        frames = self._frames.array
        saved = _SavedScans(
            self.keys,
            len(self),
            stored,
            self._steps_at(self._places.array[stored, 0]),
            frames[:, 0],
            frames[:, 1:],
            self._last_stored_pose,
            self._storage_interval,
        )
        return serialization.to_arrays(saved)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ScanArchive:
        """Rebuild an archive; ArgumentError if an array is missing, of a wrong shape, or contradicts another."""
        saved = serialization.from_arrays(_SavedScans, arrays)
        stored = [-1, *saved.stored.tolist(), saved.count]
        if any(a >= b for a, b in [*pairwise(stored), *pairwise(saved.keys)]) or not set(saved.keys) <= set(
            stored[1:-1]
        ):
            expected = f"ascending scans below {saved.count}, the key scans among them"
            raise ArgumentError("keys", expected, f"{len(saved.keys)} of {len(saved.stored)} that are not")
        archive = cls()
        archive.keys = saved.keys
        places = np.full((saved.count, 1), _NOTHING, np.int32)
        places[saved.stored, 0] = np.arange(len(saved.stored), dtype=np.int32)
        archive._places.extend(places)
        archive._frames.extend(np.column_stack([saved.steps_m, saved.origins]))
        archive._blocks, archive._extents = _gather(saved.ends)
        archive._last_stored_pose = saved.last_stored_pose
        archive._storage_interval = saved.storage_interval
        archive._between_bytes = archive._count_between()
        return archive

    def _write(self, steps: FloatArray) -> None:
        """Store end points (B, 2) of one more scan, rounded."""
        count = len(steps)
        if self._room < count:
            self._blocks.append(np.empty((max(count, _BLOCK_ENDS), 2), np.int16))
            self._room = len(self._blocks[-1])
        block = self._blocks[-1]
        first = len(block) - self._room
        np.rint(steps, out=block[first : first + count], casting="unsafe")
        self._room -= count
        self._extents.append((len(self._blocks) - 1, first, count))

    def _steps_at(self, places: NDArray[np.int32] | IntArray) -> list[NDArray[np.int16]]:
        """End points (B, 2), in steps, of the stored scans at some places."""
        extents = self._extents.array[places].tolist()
        return [self._blocks[block][first : first + count] for block, first, count in extents]

    def _thin_out(self) -> None:
        """Keep half as many of the scans that are no key scans."""
        interval = 2 * self._storage_interval
        is_kept = np.arange(len(self)) % interval == 0
        is_kept[self.keys] = True
        self._keep(np.where(is_kept, self._places.array[:, 0], _NOTHING))
        self._storage_interval = interval

    def _keep(self, places: NDArray[np.int32]) -> None:
        """Let the scans be those at some places (S,), ascending; the others give their memory back.

        Where memory is short the archive stays as it is.
        """
        is_kept = places != _NOTHING
        kept = places[is_kept]
        blocks, extents = _gather(self._steps_at(kept))
        frames = Rows[np.float64](3, np.float64)
        frames.extend(self._frames.array[kept])
        numbers = np.full((len(places), 1), _NOTHING, np.int32)
        numbers[is_kept, 0] = np.arange(len(kept), dtype=np.int32)
        renumbered = Rows[np.int32](1, np.int32)
        renumbered.extend(numbers)
        self._places, self._extents, self._frames = renumbered, extents, frames
        self._blocks = blocks
        self._room = 0
        self._between_bytes = self._count_between()

    def _count_between(self) -> int:
        """Bytes of the scans between key scans."""
        keys = self._places.array[self.keys, 0]
        return self.nbytes - _END_BYTES * int(self._extents.array[keys, 2].sum())


def _gather(ends: Sequence[NDArray[np.int16]]) -> tuple[list[NDArray[np.int16]], Rows[np.int32]]:
    """Copy the end points of scans into one block; blocks, and where in them each scan is."""
    counts = np.array([len(own) for own in ends], np.int32)
    firsts = np.cumsum(counts, dtype=np.int32) - counts
    extents = Rows[np.int32](3, np.int32)
    extents.extend(np.column_stack([np.zeros_like(counts), firsts, counts]))
    return [np.concatenate([_NO_ENDS, *ends])], extents
