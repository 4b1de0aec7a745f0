"""record.npz: the particles at each key scan, for replaying a run; archives of plain arrays."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntFlag
from functools import lru_cache
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import Limits, index_of
from gridslam.errors import ArgumentError, InputError
from gridslam.io.limits import UnpackingLimit, require_memory
from gridslam.io.measurement import FARTHEST_M
from gridslam.io.text import open_for_reading
from gridslam.serialization import read_array
from gridslam.types import FloatArray, IntArray, StepReport

_SCHEMA = "gridslam.record/1"


class RecordFlag(IntFlag):
    """Flags of one key scan."""

    LOST = 1
    RESAMPLED = 2
    UNDETERMINED = 4


@final
@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """T key scans of N particles, in the order in which they were taken.

    Where there were fewer, copies of the last one stand for the others, of weight 0.

    Attributes
    ----------
    stamps_ns : (T,) int64, ns
        Stamps of the scans.
    poses : (T, N, 3) float32
        Particles [x m, y m, theta rad] in the map frame, before resampling.
    log_weights : (T, N) float64
        Their normalized log weights, before resampling.
    parents : (T, N) int32
        For each particle after the step the one it continues.
    best : (T,) int32
        The best particle after the step.
    n_eff : (T,) float64
        Effective sample size before resampling.
    flags : (T,) uint8
        A `RecordFlag` each.
    latency_s : (T,) float64, s
        Time the step took.
    revisits : (R, 2) int32
        Tracked revisits: the older and the later key scan of each, in [0, T).
    """

    stamps_ns: IntArray
    poses: NDArray[np.float32]
    log_weights: FloatArray
    parents: NDArray[np.int32]
    best: NDArray[np.int32]
    n_eff: FloatArray
    flags: NDArray[np.uint8]
    latency_s: FloatArray
    revisits: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 2), np.int32))

    def __len__(self) -> int:
        """Return the number of key scans T."""
        return len(self.stamps_ns)

    @property
    def counts(self) -> IntArray:
        """Numbers (T,) of particles at the key scans, without those at the end of a row of weight 0."""
        there = np.isfinite(self.log_weights[:, ::-1])
        counts: IntArray = self.log_weights.shape[1] - there.argmax(axis=1)
        return counts


_FORMS: dict[str, tuple[type, int]] = {
    "stamps_ns": (np.int64, 1),
    "poses": (np.float32, 3),
    "log_weights": (np.float64, 2),
    "parents": (np.int32, 2),
    "best": (np.int32, 1),
    "n_eff": (np.float64, 1),
    "flags": (np.uint8, 1),
    "latency_s": (np.float64, 1),
}


def _fill(name: str, row: Any, most: int) -> Any:  # noqa: ANN401
    """Pad the values of each particle at a key scan with copies of the last one, of weight 0, to `most` particles."""
    missing = 0 if _FORMS[name][1] == 1 else most - len(row)
    if not missing:
        return row
    last = np.full(1, -np.inf) if name == "log_weights" else row[-1:]
    return np.concatenate([row, np.repeat(last, missing, axis=0)])


@lru_cache(maxsize=1)
def _count_up(count: int) -> NDArray[np.int32]:
    """Return the parents of particles that were not resampled, shared by all such key scans."""
    parents = np.arange(count, dtype=np.int32)
    parents.flags.writeable = False
    return parents


@final
class RecordWriter:
    """Collects the key scans of a run; other scans are passed over."""

    def __init__(self) -> None:
        """Begin without any key scan."""
        self._rows: dict[str, list[Any]] = {name: [] for name in _FORMS}

    def add(self, report: StepReport, latency_s: float) -> None:
        """Keep a step's particles, if it was a key scan."""
        if report.skipped is not None or report.poses is None or report.log_weights is None:
            return
        flags = RecordFlag.LOST * report.lost | RecordFlag.RESAMPLED * (report.parents is not None)
        flags |= RecordFlag.UNDETERMINED * (report.degenerate_direction is not None)
        count = len(report.poses)
        parents = _count_up(count) if report.parents is None else np.array(report.parents, np.int32)
        row: dict[str, Any] = {
            "stamps_ns": report.stamp_ns,
            "poses": np.array(report.poses, np.float32),
            "log_weights": np.array(report.log_weights, np.float64),
            "parents": parents,
            "best": report.best,
            "n_eff": report.n_eff,
            "flags": int(flags),
            "latency_s": latency_s,
        }
        for name, value in row.items():
            self._rows[name].append(value)

    @property
    def particles_mean(self) -> float:
        """Number of particles on average; 0 without any key scan."""
        rows = self._rows["log_weights"]
        return sum(np.count_nonzero(row > -np.inf) for row in rows) / max(len(rows), 1)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the collected values as the arrays of `Record`; of length 0 without any key scan."""
        shape = (0, 0, 3)  # of the poses, where there are none
        most = max((len(row) for name in ("poses", "parents") for row in self._rows[name]), default=0)
        return {
            name: np.array([_fill(name, row, most) for row in self._rows[name]] or np.zeros(shape[:ndim]), dtype)
            for name, (dtype, ndim) in _FORMS.items()
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> RecordWriter:
        """Continue a recorder from the arrays of `to_arrays`; raises ArgumentError for other arrays."""
        self = cls()
        self._rows = {name: list(values) for name, values in _read(arrays, {}).items()}
        return self

    def snapshot(self) -> RecordWriter:
        """Keep a copy for later."""
        twin = RecordWriter()
        twin._rows = {name: rows.copy() for name, rows in self._rows.items()}
        return twin

    def write(self, path: str | Path, revisits: IntArray | None = None) -> None:
        """Write the collected values, compressed, and tracked revisits (R, 2); arrays of length 0 without key scans."""
        arrays: dict[str, Any] = self.to_arrays()
        arrays["revisits"] = np.zeros((0, 2), np.int32) if revisits is None else revisits.astype(np.int32)
        with Path(path).open("wb") as file:
            np.savez_compressed(file, schema=np.array(_SCHEMA), **arrays)


def _read(arrays: Mapping[str, NDArray[Any]], sizes: dict[str, int]) -> dict[str, NDArray[Any]]:
    """Return copies of the arrays of a recorder, whose `sizes` become known; raises ArgumentError for other ones."""
    lengths = ("key scans", "particles", 3)
    content = {name: read_array(arrays, name, dtype, lengths[:ndim], sizes) for name, (dtype, ndim) in _FORMS.items()}
    for name in ("parents", "best"):
        index_of("particles").require(name, content[name], sizes)
    return content


def read_record(path: str | Path) -> Record:
    """Read a record; raises InputError where the file is none, or its arrays do not belong together."""
    arrays = {"revisits": np.zeros((0, 2), np.int32)} | read_arrays(path, _SCHEMA, "a record of a run")
    sizes: dict[str, int] = {}
    try:
        record = Record(**_read(arrays, sizes), revisits=read_array(arrays, "revisits", np.int32, (None, 2)))
        index_of("key scans").require("revisits", record.revisits, sizes)
        Limits(-FARTHEST_M, FARTHEST_M).require("poses", record.poses, sizes)  # m and rad
        Limits(-math.inf, 50.0).require("log_weights", record.log_weights, sizes)
        Limits(0, 1.001 * sizes["particles"]).require("n_eff", record.n_eff, sizes)
        Limits(0, 1e9).require("latency_s", record.latency_s, sizes)
    except ArgumentError as error:
        raise InputError(path, str(error)) from None
    if len(record) and not sizes["particles"]:
        raise InputError(path, f"expected particles at {len(record)} key scans, got none")
    return record


def read_arrays(path: str | Path, schema: str, what: str) -> dict[str, NDArray[Any]]:
    """Return all arrays of an .npz without pickles.

    Raises InputError where the file is not `what`, is of another schema, or unpacks to more than
    is allowed.
    """
    arrays: dict[str, NDArray[Any]] = {}
    with open_for_reading(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                _require_small(path, archive)
                for member in archive.infolist():
                    name = member.filename.removesuffix(".npy")
                    arrays[name] = _read_member(archive, member)
        except InputError:
            raise
        except Exception as error:  # whatever zip, zlib and NumPy come across in a damaged archive
            raise InputError(path, f"expected {what}, got: {error or type(error).__name__}") from None
    found = arrays.get("schema")
    got = "none" if found is None else str(found) if found.size == 1 else f"{found.dtype} of shape {found.shape}"
    if got != schema:
        raise InputError(path, f"expected schema {schema}, got {got:.100}")
    return arrays


def _require_small(path: str | Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that claims to hold more than is allowed; no more than it claims is unpacked."""
    limit = UnpackingLimit(Path(path).stat().st_size)
    size = sum(member.file_size for member in archive.infolist())
    require_memory(path, "its content", size)
    if not limit.take(size):
        raise InputError(path, limit.problem)


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Read an array; raises ValueError where its header does not fit its bytes."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename} is compressed in a way that is not known")
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        if version not in _HEADERS:
            raise ValueError(f"{member.filename} is of version {version}")
        shape, is_fortran, dtype = _HEADERS[version](stream)
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds objects")
        size = math.prod(shape) * dtype.itemsize
        content = stream.read()
    if len(content) != size:
        raise ValueError(f"{member.filename} is {dtype} of shape {shape}, of which {len(content)} bytes are there")
    return np.ndarray(shape, dtype, content, order="F" if is_fortran else "C")


_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
