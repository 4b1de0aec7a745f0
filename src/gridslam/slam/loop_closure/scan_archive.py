"""Archive of scans for rebuilding maps and rematching after corrections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam import serialization
from gridslam.arguments import Limits
from gridslam.errors import ArgumentError
from gridslam.geometry.single_pose import UNKNOWN_POSE, Pose, is_within
from gridslam.grid.scan_batch import ScanBatch
from gridslam.types import BeamEnds, FloatArray, IntArray, StoredScan

_STEPS = 32767
_NEAR_M = 0.02
_NEAR_RAD = 0.01
_BETWEEN_KEYS = 256
"""Of a laser with 1080 beams over 270 degrees 128, 256 and all of them gave the same trajectory, to 3 mm at worst."""
_MOST_BYTES = 32_000_000
"""Of the scans between key scans: 45,000 of 180 beams."""
_MOST_SCANS = 100_000_000
"""Of a saved archive: a month at 40 Hz."""

_NO_STEPS = np.empty((0, 2), np.int16)


class _Stored(NamedTuple):
    """End points (B, 2) in steps of a length (m), and where the laser was in the base frame, (2,)."""

    steps: NDArray[np.int16]
    step_m: float
    origin: FloatArray


_NOTHING = _Stored(_NO_STEPS, 1.0, np.zeros(2))


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


@final
class ScanArchive:
    """End points of the usable beams of each scan, 4 bytes a beam: in steps of the farthest one's 32,767th part.

    That is 1 mm where a laser sees 30 m. Key scans, from which maps are drawn, are kept whole. The others are only
    matched again, one by one: of them every k-th beam is kept, with the least k that leaves at most 256. Of one taken
    within 2 cm and 0.01 rad of the last one that was kept nothing is kept: it saw the same, and a robot that stands for
    hours would fill the memory. So would one that drives for hours: of all these the first 32 MB are kept, after some
    hours of driving. What is not kept is not matched again, and lies as it was tracked between the key scans.

    Attributes
    ----------
    keys : list of int
        Which scans are key scans.
    """

    __slots__ = ("_between_bytes", "_last_stored_pose", "_stored", "keys")

    def __init__(self) -> None:
        self.keys: list[int] = []
        self._stored: list[_Stored | None] = []  # of each scan; None where nothing is kept
        self._last_stored_pose = UNKNOWN_POSE
        self._between_bytes = 0  # of the scans between key scans

    def append(self, beams: BeamEnds, pose: Pose, *, is_key: bool) -> None:
        """Append a scan from `pose` in a frame that drifts slowly."""
        ends = beams.ends
        if not is_key and (
            not len(ends)
            or self._between_bytes > _MOST_BYTES
            or is_within(pose, self._last_stored_pose, _NEAR_M, _NEAR_RAD)
        ):
            self._stored.append(None)
            return
        if not is_key:
            ends = ends[:: max(1, -(-len(ends) // _BETWEEN_KEYS))]
        step_m = float(np.abs(ends).max(initial=0.0)) / _STEPS or 1.0
        stored = _Stored(np.rint(ends / step_m).astype(np.int16), step_m, np.array(beams.origin, np.float64))
        self._stored.append(stored)
        if len(ends):
            self._last_stored_pose = pose
        if is_key:
            self.keys.append(len(self) - 1)
        else:
            self._between_bytes += stored.steps.nbytes

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._stored)

    def __getitem__(self, scan: int) -> StoredScan:
        """Scan number `scan`, from 0; without beams if nothing is kept of it."""
        stored = self._stored[scan] or _NOTHING
        return StoredScan(np.multiply(stored.steps, stored.step_m, dtype=np.float64), stored.origin)

    def key(self, key: int) -> StoredScan:
        """Key scan number `key`, from 0."""
        return self[self.keys[key]]

    def batch(self, scans: Sequence[int]) -> ScanBatch:
        """Scans by number, side by side; without beams those of which nothing is kept."""
        stored = [self._stored[scan] or _NOTHING for scan in scans]
        counts = np.array([len(each.steps) for each in stored], np.int64)
        steps = np.concatenate([_NO_STEPS, *(each.steps for each in stored)])
        steps_m = np.repeat(np.array([each.step_m for each in stored], np.float64), counts)
        origins = np.array([each.origin for each in stored]).reshape(-1, 2)
        starts = np.concatenate([[0], np.cumsum(counts)])
        return ScanBatch(np.multiply(steps, steps_m[:, None], dtype=np.float64), starts, origins)

    @property
    def nbytes(self) -> int:
        """Bytes of the end points."""
        return sum(each.steps.nbytes for each in self._stored if each is not None)

    def extend(self, later: ScanArchive) -> None:
        """Append the scans of another archive, which follow those of this one."""
        self.keys += [len(self) + key for key in later.keys]
        self._stored += later._stored
        self._last_stored_pose = later._last_stored_pose
        self._between_bytes += later._between_bytes

    def select(self, scans: IntArray, bare: IntArray) -> ScanArchive:
        """Another archive of some scans (N,), ascending, numbered from 0; of those in `bare` (M,) nothing is kept."""
        number = {scan: place for place, scan in enumerate(scans.tolist())}
        selected = self.snapshot()
        selected.keys = [number[key] for key in self.keys if key in number]
        dropped = set(bare.tolist())
        selected._keep([None if scan in dropped else self._stored[scan] for scan in number])
        return selected

    def truncate(self, scans: int, key_scans: int) -> None:
        """Forget all but the first scans, of which `key_scans` are key scans."""
        if scans == len(self):
            return
        del self.keys[key_scans:]
        self._last_stored_pose = UNKNOWN_POSE  # so the next scan is kept
        self._keep(self._stored[:scans])

    def snapshot(self) -> ScanArchive:
        """Keep a copy for later; the end points themselves, which never change, are shared."""
        twin = copy(self)
        twin.keys = self.keys.copy()
        twin._stored = self._stored.copy()
        return twin

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays, from which `from_arrays` restores an identical archive."""
        stored = {scan: each for scan, each in enumerate(self._stored) if each is not None}
        saved = _SavedScans(
            self.keys,
            len(self),
            np.array(list(stored), np.int64),
            [each.steps for each in stored.values()],
            np.array([each.step_m for each in stored.values()], np.float64),
            np.array([each.origin for each in stored.values()], np.float64).reshape(-1, 2),
            self._last_stored_pose,
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
        archive._stored = [None] * saved.count
        parts = map(_Stored, saved.ends, saved.steps_m.tolist(), saved.origins)
        for scan, each in zip(saved.stored.tolist(), parts, strict=True):
            archive._stored[scan] = each
        archive._last_stored_pose = saved.last_stored_pose
        archive._keep(archive._stored)
        return archive

    def _keep(self, stored: list[_Stored | None]) -> None:
        """Let these be the scans, and count the bytes of those between key scans."""
        self._stored = stored
        self._between_bytes = self.nbytes - sum((stored[key] or _NOTHING).steps.nbytes for key in self.keys)
