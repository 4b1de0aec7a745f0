"""history.npz: the moments of a run, for `gridslam view`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.io.results.record import read_arrays
from gridslam.io.sessions.archive_file import name_file
from gridslam.live.history import TILE_BYTES, History, Moment, unpack_tiles
from gridslam.serialization import from_arrays, to_arrays

HISTORY_NAME = "history.npz"
HISTORY_SCHEMA = "gridslam.history/2"
_WHAT = "a history of a run"
_MOST_BYTES = 1 << 30  # of a moment's tiles


class _Saved(NamedTuple):
    """The content of a file."""

    moments: list[Moment]


def write_history(path: str | Path, history: History) -> None:
    """Write the moments of a run; the tiles in it are compressed."""
    with Path(path).open("wb") as file:
        np.savez(file, schema=np.array(HISTORY_SCHEMA), **to_arrays(_Saved(history.moments)))  # type: ignore[arg-type]


def read_history(path: str | Path) -> History:
    """Read the moments of a run.

    Raises
    ------
    InputError
        The file is none, or its arrays do not belong together.
    """
    arrays = read_arrays(path, HISTORY_SCHEMA, _WHAT)
    with name_file(path, _WHAT):
        moments = from_arrays(_Saved, arrays).moments
        _check(moments)
    history = History(max(2 * len(moments), 2))
    history.moments = moments
    return history


def _check(moments: Sequence[Moment]) -> None:
    """Raise ArgumentError or ValueError where moments do not follow one another, or their tiles cannot be unpacked."""
    keys = positions = 0
    for moment in moments:
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
