"""The scans of a run, kept so that maps can be drawn again and scans matched again when the past is corrected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.slam.tracker_state import is_within
from gridslam.types import BeamEnds, EndPoints, FloatArray

__all__ = ["ScanArchive"]

_NEAR_M, _NEAR_RAD = 0.02, 0.01
_NOTHING = np.empty((0, 2), np.float32)


@final
class ScanArchive:
    """End points of the usable beams of each scan, 8 bytes a beam (float32: a hundredth of a millimetre at 100 m).

    Of a scan that is no key scan, taken within 2 cm and 0.01 rad of the last one that was kept, nothing is kept: it saw
    the same, and a robot that stands for hours would fill the memory.

    Attributes
    ----------
    keys : list of int
        Which scans are key scans.
    """

    __slots__ = ("_ends", "_kept", "_origins", "keys")

    def __init__(self) -> None:
        """Begin without any scan."""
        self._ends: list[NDArray[np.float32]] = []
        self._origins: list[FloatArray] = []
        self._kept: FloatArray = np.full(3, np.nan)
        self.keys: list[int] = []

    def append(self, beams: BeamEnds, pose: FloatArray, *, is_key: bool) -> None:
        """Take note of one more scan, from `pose` (3,) in a frame that drifts slowly."""
        if is_key:
            self.keys.append(len(self))
        if not is_key and is_within(pose, self._kept, _NEAR_M, _NEAR_RAD):
            self._ends.append(_NOTHING)
        else:
            self._ends.append(beams.ends.astype(np.float32))
            self._kept = pose
        self._origins.append(beams.origin)

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._ends)

    def __getitem__(self, scan: int) -> EndPoints:
        """Scan number `scan`, from 0."""
        return EndPoints(self._ends[scan].astype(np.float64), self._origins[scan])

    def key(self, key: int) -> EndPoints:
        """Key scan number `key`, from 0."""
        return self[self.keys[key]]

    @property
    def nbytes(self) -> int:
        """Bytes of the end points."""
        return sum(ends.nbytes for ends in self._ends)

    def snapshot(self) -> ScanArchive:
        """Keep a copy for later; the scans themselves, which never change, are shared."""
        twin = ScanArchive()
        twin._ends, twin._origins, twin.keys = self._ends.copy(), self._origins.copy(), self.keys.copy()
        twin._kept = self._kept
        return twin

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays: `counts` (T,) int64 beams of each scan, `ends` (sum, 2) float32, `origins` (T, 2) float64.

        `keys` (K,) int64 are the key scans, and `kept` (3,) float64 is the pose of the last scan that was kept.
        """
        return {
            "counts": np.array([len(ends) for ends in self._ends], np.int64),
            "ends": np.concatenate([np.empty((0, 2), np.float32), *self._ends]),
            "origins": np.array(self._origins, np.float64).reshape(-1, 2),
            "keys": np.array(self.keys, np.int64),
            "kept": self._kept,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ScanArchive:
        """Rebuild from `to_arrays`; raises KeyError where an array is missing, ArgumentError where they do not fit."""
        counts, ends, origins = (arrays[name] for name in ("counts", "ends", "origins"))
        if ends.shape != (int(counts.sum()), 2) or origins.shape != (len(counts), 2) or (counts < 0).any():
            raise ArgumentError("ends, origins", f"{counts.sum()} ends of {len(counts)} scans", ends.shape)
        twin = cls()
        twin._ends = np.split(ends.astype(np.float32), np.cumsum(counts)[:-1]) if len(counts) else []
        twin._origins, twin.keys = list(origins.astype(np.float64)), arrays["keys"].tolist()
        twin._kept = arrays["kept"]
        return twin
