"""The past of a run: its key scans, and moments of them with map, path, pose, scan and particles as they were."""

from __future__ import annotations

import zlib
from array import array
from bisect import bisect_right
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.live.protocol import NO_POINTS, Float32Array
from gridslam.live.scene import NO_PARTICLES, Frame, finite_or_none
from gridslam.live.tiles import TILE_BYTES, PackedTiles, TileReplica
from gridslam.slam.loop_closure.constraints import select_shown_closures
from gridslam.types import FloatArray, IntArray, StepReport

if TYPE_CHECKING:
    from gridslam.localization import LocalizationReport

LOST = 1
"""Flag of a key scan: the robot was lost."""
CORRECTED = 8
"""Flag of a key scan: a correction of the trajectory followed."""
SCAN_UNIT_M = 0.01
"""Scans are stored in whole multiples of this length."""
_MOST_MOMENTS = 512
_FIRST_INTERVAL = 8
_COMPRESSION = 1  # of zlib: a moment of the Intel log takes 0.15 ms


@final
class Moment(NamedTuple):
    """A run after one of its key scans, as changes since the moment before.

    Attributes
    ----------
    keys : int
        Number of key scans so far.
    stamp_ns : int, ns
        Stamp of the last of them.
    pose : (3,) float64
        Estimated pose, x m, y m, theta rad.
    first : int
        Number of positions that the path shares with the one of the moment before.
    path : (P, 2) float32, m
        The other positions of the path, NaN where the robot was lost.
    at : (K, 2) int32
        Rows and columns of the tiles that changed.
    tiles : (B,) uint8
        Their packed levels, (K, `TILE_BYTES`) uint8, compressed by zlib.
    scan : (S, 2) int16
        End points of the scan in the robot frame, in units of `SCAN_UNIT_M`.
    particles : (N, 4) float32
        x m, y m, theta rad and weight, each for a share of the belief.
    """

    keys: int
    stamp_ns: int
    pose: Annotated[FloatArray, 3]
    first: int
    path: Annotated[Float32Array, None, 2]
    at: Annotated[NDArray[np.int32], None, 2]
    tiles: Annotated[NDArray[np.uint8], None]
    scan: Annotated[NDArray[np.int16], None, 2]
    particles: Annotated[Float32Array, None, 4] = NO_PARTICLES

    def unpack(self) -> PackedTiles:
        """Return the tiles that changed."""
        data = unpack_tiles(self.tiles, len(self.at))
        starts = range(0, len(data), TILE_BYTES)
        return {
            (row, column): data[k : k + TILE_BYTES] for (row, column), k in zip(self.at.tolist(), starts, strict=True)
        }


def unpack_tiles(tiles: NDArray[np.uint8], count: int) -> bytes:
    """Return the packed levels of this number of tiles; raises ValueError where there are not as many."""
    size = count * TILE_BYTES
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(tiles.tobytes(), size + 1) if len(tiles) else b""
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if len(data) != size:
        raise ValueError(f"expected {size} bytes of tiles, got {'more' if len(data) > size else len(data)}")
    return data


def compress_tiles(tiles: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return packed levels (K, `TILE_BYTES`), compressed: (B,)."""
    return np.frombuffer(zlib.compress(tiles.tobytes(), _COMPRESSION) if len(tiles) else b"", np.uint8)


@final
class History:
    """The past of a run; written by one thread, read by others.

    After each half of `most` moments the interval between the next ones is doubled: their number grows with the
    logarithm of the run's length. The first one is after the first key scan.

    Parameters
    ----------
    most : int, >= 4
        Moments of a run in which the interval was doubled twice.
    interval : int, >= 1
        Key scans between two moments at first.

    Attributes
    ----------
    moments : list of Moment
        Appended to.
    interval : int
        Key scans between two moments.
    stamps_ns, scans : list of int
        Stamp of each key scan, and number of scans by then.
    figures : array of float
        Rows of `series`, one after the other.
    closures : (C, 2) int64
        Key scans of the loop closures so far: the older and the later one.
    recognized : int
        How many of them, from the first on, are recognized; the others are tracked.
    """

    def __init__(self, most: int = _MOST_MOMENTS, interval: int = _FIRST_INTERVAL) -> None:
        """Start without moments."""
        self.moments: list[Moment] = []
        self.interval = interval
        self.stamps_ns: list[int] = []
        self.scans: list[int] = []
        self.closures: IntArray = np.zeros((0, 2), np.int64)
        self.recognized = 0
        self.figures = array("f")
        self._half = most // 2

    @property
    def series(self) -> Float32Array:
        """The figures (S, 5) of each key scan, as in a scene."""
        return np.frombuffer(self.figures.tobytes(), np.float32).reshape(-1, 5)

    def note_report(self, report: StepReport | LocalizationReport, scans: int, seconds: float) -> None:
        """Note a key scan by its report, the number of scans by then, and the time that it took, s."""
        self.stamps_ns.append(report.stamp_ns)
        self.scans.append(scans)
        time_s = 1e-9 * (report.stamp_ns - self.stamps_ns[0])
        flags = LOST * report.lost | CORRECTED * (isinstance(report, StepReport) and report.corrected)
        count = 0 if report.poses is None else len(report.poses)
        self.figures.extend((time_s, report.n_eff, 1e3 * seconds, flags, count))

    def describe(self, at: int) -> dict[str, Any]:
        """Return the values of a key scan, counted from 0, for the page."""
        time_s, n_eff, _, flags, particles = self.series[at].tolist()
        return {
            "time_s": time_s,
            "n_eff": finite_or_none(n_eff),
            "lost": bool(int(flags) & LOST),
            "particles": int(particles),
            "keys": at + 1,
            "scans": self.scans[at],
            "closures": int((self.closures[:, 1] <= at).sum()),
        }

    def make_frame(self, path: Float32Array, particles: Float32Array = NO_PARTICLES) -> Frame:
        """Return a path (T, 2) and particles (N, 4) with the loop closures between key scans of this path."""
        pairs = select_shown_closures(self.closures[: self.recognized], self.closures[self.recognized :])
        return Frame(path, particles, path[pairs[pairs[:, 1] < len(path)]].reshape(-1, 4))

    def is_due(self, keys: int) -> bool:
        """Return whether the key scan of this number, from 1, is to be a moment."""
        return keys % self.interval == 0 or keys == 1

    def add(self, moment: Moment) -> None:
        """Add the next moment."""
        self.moments.append(moment)
        if len(self.moments) % self._half == 0:
            self.interval *= 2

    def find(self, keys: int) -> int:
        """Return the index of the last moment at most at a number of key scans; -1 if there is none."""
        return bisect_right(self.moments, keys, key=lambda moment: moment.keys) - 1


@final
class PastReader:
    """Reads a history at any of its moments in any order.

    Attributes
    ----------
    replica : TileReplica
        The map as it was at the moment that was read last.
    """

    def __init__(self, history: History) -> None:
        """Start before the first moment."""
        self._history = history
        self._rewind()
        self.replica = TileReplica()

    def _rewind(self) -> None:
        self._tiles: PackedTiles = {}
        self._path = NO_POINTS
        self._index = -1

    def read(self, keys: int) -> tuple[Moment, Frame] | None:
        """Return the run after at most this number of key scans, and update the map; None before the first moment."""
        history = self._history
        index = history.find(keys)
        if index < 0:
            return None
        if index < self._index:
            self._rewind()
        for moment in history.moments[self._index + 1 : index + 1]:
            self._tiles.update(moment.unpack())
            self._path = np.concatenate([self._path[: moment.first], moment.path])
        self._index = index
        self.replica.replace(self._tiles)
        moment = history.moments[index]
        return moment, history.make_frame(self._path, moment.particles)


def round_scan(ends: FloatArray | Float32Array) -> NDArray[np.int16]:
    """Round end points (K, 2), m, to `SCAN_UNIT_M`; points beyond 327 m are left out."""
    steps = np.rint(ends / SCAN_UNIT_M)
    near = (np.abs(steps) < np.iinfo(np.int16).max).all(axis=1)
    rounded: NDArray[np.int16] = steps[near].astype(np.int16)
    return rounded
