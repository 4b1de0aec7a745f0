"""history.npz: the past of a run, for `gridslam view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from gridslam.arguments import COUNT
from gridslam.errors import ArgumentError
from gridslam.io.sessions.archive_file import name_file, read_arrays
from gridslam.live.history import History, Moment, unpack_tiles
from gridslam.live.protocol import Float32Array
from gridslam.live.tiles import TILE_BYTES
from gridslam.serialization import from_arrays, to_arrays
from gridslam.types import IntArray

HISTORY_NAME = "history.npz"
HISTORY_SCHEMA = "gridslam.history/3"
_WHAT = "a history of a run"
_MOST_BYTES = 1 << 30  # of a moment's tiles
_MOST = 1e12


class _Saved(NamedTuple):
    """The content of a file."""

    moments: list[Moment]
    stamps_ns: Annotated[IntArray, "key scans"]
    scans: Annotated[IntArray, "key scans"]
    series: Annotated[Float32Array, "key scans", 5]
    closures: Annotated[IntArray, None, 2]
    recognized: Annotated[int, COUNT]


def write_history(path: str | Path, history: History) -> None:
    """Write the past of a run; the tiles in it are compressed."""
    stamps_ns, scans = (np.array(values, np.int64) for values in (history.stamps_ns, history.scans))
    saved = _Saved(history.moments, stamps_ns, scans, history.series, history.closures, history.recognized)
    with Path(path).open("wb") as file:
        np.savez(file, schema=np.array(HISTORY_SCHEMA), **to_arrays(saved))  # type: ignore[arg-type]


def read_history(path: str | Path) -> History:
    """Read the past of a run.

    Raises
    ------
    InputError
        The file is none, or its arrays do not belong together.
    """
    arrays = read_arrays(path, HISTORY_SCHEMA, _WHAT)
    with name_file(path, _WHAT):
        saved = from_arrays(_Saved, arrays)
        _check(saved)
        moments = saved.moments
        history = History(max(2 * len(moments), 2))
        history.moments = moments
        history.closures = saved.closures
        history.recognized = saved.recognized
        history.stamps_ns = saved.stamps_ns.tolist()
        history.scans = saved.scans.tolist()
        history.figures.frombytes(saved.series.tobytes())
    return history


def _check(saved: _Saved) -> None:
    """Raise ArgumentError or ValueError where moments do not follow one another, or their tiles cannot be unpacked."""
    figures = saved.series[:, 2:]
    if not (np.isfinite(saved.series[:, 0]).all() and ((figures >= 0) & (figures < _MOST)).all()):
        raise ArgumentError("series", f"figures from 0 to {_MOST:g}", "others")
    if (np.diff(saved.closures) < 0).any() or (saved.closures < 0).any():
        raise ArgumentError("closures", "pairs of key scans, the older one first", "others")
    keys = positions = 0
    for moment in saved.moments:
        if moment.keys <= keys:
            raise ArgumentError("moments.keys", "numbers of key scans in ascending order", moment.keys)
        if not 0 <= moment.first <= positions:
            raise ArgumentError("moments.first", f"a number of positions up to {positions}", moment.first)
        if not (np.isfinite(moment.pose).all() and np.isfinite(moment.particles).all()):
            raise ArgumentError("moments.pose, moments.particles", "finite numbers", "others")
        if len(moment.at) * TILE_BYTES > _MOST_BYTES:
            raise ArgumentError("moments.at", f"at most {_MOST_BYTES // TILE_BYTES} tiles", len(moment.at))
        unpack_tiles(moment.tiles, len(moment.at))
        keys, positions = moment.keys, moment.first + len(moment.path)
    if keys > len(saved.stamps_ns):
        raise ArgumentError("moments.keys", f"at most {len(saved.stamps_ns)} key scans", keys)
