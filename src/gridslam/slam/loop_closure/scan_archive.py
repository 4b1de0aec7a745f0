"""Archive of scans for rebuilding maps and rematching after corrections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.slam.tracking.state import is_within
from gridslam.types import BeamEnds, FloatArray, StoredScan

__all__ = ["ScanArchive"]

_STEPS = 32767
_NEAR_M, _NEAR_RAD = 0.02, 0.01
_BETWEEN_KEYS = 256
"""Of a laser with 1080 beams over 270 degrees 128, 256 and all of them gave the same trajectory, to 3 mm at worst."""
_MOST_BYTES = 32_000_000
"""45,000 scans of 180 beams."""

_NOTHING = np.empty((0, 2), np.int16)


@final
class ScanArchive:
    """End points of the usable beams of each scan, 4 bytes a beam: in steps of the farthest one's 32,767th part.

    That is 1 mm where a laser sees 30 m. Key scans, from which maps are drawn, are kept whole. The others are only
    matched again, one by one: of them every k-th beam is kept, with the least k that leaves at most 256. Of one taken
    within 2 cm and 0.01 rad of the last one that was kept nothing is kept: it saw the same, and a robot that stands for
    hours would fill the memory. So would one that drives for hours: when all these come to more than 32 MB, only every
    second scan is kept from then on and from the begin, later only every fourth.

    Attributes
    ----------
    keys : list of int
        Which scans are key scans.
    """

    __slots__ = ("_between_bytes", "_ends", "_every", "_kept", "_origins", "_steps_m", "keys")

    def __init__(self) -> None:
        """Begin without any scan."""
        self._ends: list[NDArray[np.int16]] = []
        self._steps_m: list[float] = []
        self._origins: list[FloatArray] = []
        self._kept: FloatArray = np.full(3, np.nan)
        self._every, self._between_bytes = 1, 0
        self.keys: list[int] = []

    def append(self, beams: BeamEnds, pose: FloatArray, *, is_key: bool) -> None:
        """Append a scan from `pose` (3,) in a frame that drifts slowly."""
        scan, ends = len(self), beams.ends
        if is_key:
            self.keys.append(scan)
        elif scan % self._every or is_within(pose, self._kept, _NEAR_M, _NEAR_RAD):
            ends = ends[:0]
        else:
            ends = ends[:: max(1, -(-len(ends) // _BETWEEN_KEYS))]
        step_m = (len(ends) and float(np.abs(ends).max()) / _STEPS) or 1.0
        self._ends.append(np.rint(ends / step_m).astype(np.int16) if len(ends) else _NOTHING)
        self._steps_m.append(step_m)
        self._origins.append(beams.origin)
        if len(ends):
            self._kept = pose
        if not is_key:
            self._between_bytes += self._ends[-1].nbytes
        if self._between_bytes > _MOST_BYTES:
            self._thin_out()

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._ends)

    def __getitem__(self, scan: int) -> StoredScan:
        """Scan number `scan`, from 0."""
        return StoredScan(self._ends[scan] * np.float64(self._steps_m[scan]), self._origins[scan])

    def key(self, key: int) -> StoredScan:
        """Key scan number `key`, from 0."""
        return self[self.keys[key]]

    @property
    def nbytes(self) -> int:
        """Bytes of the end points."""
        return sum(ends.nbytes for ends in self._ends)

    def snapshot(self) -> ScanArchive:
        """Keep a copy for later; the scans themselves, which never change, are shared."""
        twin = ScanArchive()
        twin._ends, twin._steps_m, twin._origins = self._ends.copy(), self._steps_m.copy(), self._origins.copy()
        twin._kept, twin._every, twin._between_bytes = self._kept, self._every, self._between_bytes
        twin.keys = self.keys.copy()
        return twin

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays: `counts` (T,) int64 beams of each scan, `ends` (sum, 2) int16, `origins` (T, 2) float64.

        `steps` (T,) float64 is what one of the ends' numbers means in metres. `keys` (K,) int64 are the key scans,
        `kept` (3,) float64 is the pose of the last scan that was kept, and one in `every` () int64 is.
        """
        return {
            "counts": np.array([len(ends) for ends in self._ends], np.int64),
            "ends": np.concatenate([_NOTHING, *self._ends]),
            "steps": np.array(self._steps_m, np.float64),
            "origins": np.array(self._origins, np.float64).reshape(-1, 2),
            "keys": np.array(self.keys, np.int64),
            "kept": self._kept,
            "every": np.array(self._every, np.int64),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ScanArchive:
        """Rebuild from `to_arrays`; raises KeyError where an array is missing, ArgumentError where they do not fit."""
        counts, ends, steps, origins = (arrays[name] for name in ("counts", "ends", "steps", "origins"))
        scans, fits = len(counts), ends.shape == (int(counts.sum()), 2) and (counts >= 0).all()
        if not fits or steps.shape != (scans,) or origins.shape != (scans, 2):
            raise ArgumentError("ends, steps, origins", f"{counts.sum()} ends of {scans} scans", ends.shape)
        twin = cls()
        twin._ends = np.split(ends.astype(np.int16), np.cumsum(counts)[:-1]) if scans else []
        twin._steps_m, twin._origins = steps.tolist(), list(origins.astype(np.float64))
        twin._kept, twin._every, twin.keys = arrays["kept"], int(arrays["every"]), arrays["keys"].tolist()
        twin._between_bytes = twin.nbytes - sum(twin._ends[key].nbytes for key in twin.keys)
        return twin

    def _thin_out(self) -> None:
        """Keep half as many of the scans that are no key scans."""
        self._every *= 2
        keys = set(self.keys)
        for scan in range(len(self)):
            if scan % self._every and scan not in keys:
                self._between_bytes -= self._ends[scan].nbytes
                self._ends[scan] = _NOTHING
