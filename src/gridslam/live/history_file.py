"""history.npz: the moments of a run, for `gridslam view`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.results.record import read_arrays
from gridslam.live.history import TILE_BYTES, History, Moment, unpack_tiles

__all__ = ["HISTORY_NAME", "HISTORY_SCHEMA", "read_history", "write_history"]

HISTORY_NAME = "history.npz"
HISTORY_SCHEMA = "gridslam.history/1"

_FORMS: dict[str, tuple[type, tuple[int, ...]]] = {  # items of one moment or of all of them, one after the other
    "keys": (np.int64, ()),
    "stamps_ns": (np.int64, ()),
    "poses": (np.float64, (3,)),
    "path_firsts": (np.int64, ()),
    "path_counts": (np.int64, ()),
    "path": (np.float32, (2,)),
    "tile_counts": (np.int64, ()),
    "tiles_at": (np.int32, (2,)),
    "tile_bytes": (np.int64, ()),
    "tiles": (np.uint8, ()),
    "scan_counts": (np.int64, ()),
    "scans": (np.int16, (2,)),
    "particle_counts": (np.int64, ()),
    "particles": (np.float32, (4,)),
}
_COUNTED = {"path_counts": "path", "tile_counts": "tiles_at", "tile_bytes": "tiles", "scan_counts": "scans"}
_COUNTED |= {"particle_counts": "particles"}
_OF_A_MOMENT = {"keys", "stamps_ns", "poses", "path_firsts", *_COUNTED}


def write_history(path: str | Path, history: History) -> None:
    """Write the moments of a run; the tiles in it are compressed."""
    moments = history.moments
    lists: dict[str, list[Any]] = {
        "keys": [moment.keys for moment in moments],
        "stamps_ns": [moment.stamp_ns for moment in moments],
        "poses": [moment.pose for moment in moments],
        "path_firsts": [moment.first for moment in moments],
        "path_counts": [len(moment.path) for moment in moments],
        "tile_counts": [len(moment.at) for moment in moments],
        "tile_bytes": [len(moment.tiles) for moment in moments],
        "scan_counts": [len(moment.scan) for moment in moments],
        "particle_counts": [len(moment.particles) for moment in moments],
    }
    arrays: dict[str, NDArray[Any]] = {
        name: np.array(rows, _FORMS[name][0]).reshape(-1, *_FORMS[name][1]) for name, rows in lists.items()
    }
    parts: dict[str, list[NDArray[Any]]] = {
        "path": [moment.path for moment in moments],
        "tiles_at": [moment.at for moment in moments],
        "tiles": [np.frombuffer(moment.tiles, np.uint8) for moment in moments],
        "scans": [moment.scan for moment in moments],
        "particles": [moment.particles for moment in moments],
    }
    for name, items in parts.items():
        dtype, shape = _FORMS[name]
        arrays[name] = np.concatenate([np.zeros((0, *shape), dtype), *items])
    with Path(path).open("wb") as file:
        np.savez(file, schema=np.array(HISTORY_SCHEMA), **arrays)  # type: ignore[arg-type]


def read_history(path: str | Path) -> History:
    """Read the moments of a run.

    Raises
    ------
    InputError
        The file is none, or its arrays do not belong together.
    """
    arrays = read_arrays(path, HISTORY_SCHEMA, "a history of a run")
    moments = len(arrays.get("keys", np.zeros(0)))
    for name, (dtype, shape) in _FORMS.items():
        found = arrays.get(name)
        if found is None or found.dtype != dtype or found.shape[1:] != shape or found.ndim != 1 + len(shape):
            got = "nothing" if found is None else f"{found.dtype} {found.shape}"
            raise InputError(path, f"expected {name} as {np.dtype(dtype)} (K, {', '.join(map(str, shape))}), got {got}")
        if name in _OF_A_MOMENT and len(found) != moments:
            raise InputError(path, f"{name}: expected {moments} moments, got {len(found)}")
    _check_numbers(path, arrays)
    history = History(max(2 * moments, 2))
    begins = dict.fromkeys(_COUNTED, 0)
    for k in range(moments):
        part: dict[str, NDArray[Any]] = {}
        for count, name in _COUNTED.items():
            end = begins[count] + int(arrays[count][k])
            part[name] = arrays[name][begins[count] : end]
            begins[count] = end
        moment = Moment(
            int(arrays["keys"][k]),
            int(arrays["stamps_ns"][k]),
            arrays["poses"][k],
            int(arrays["path_firsts"][k]),
            part["path"],
            part["tiles_at"],
            part["tiles"].tobytes(),
            part["scans"],
            part["particles"],
        )
        _check_moment(path, k, moment)
        history.add(moment)
    return history


def _check_numbers(path: str | Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse counts that do not add up, key scans that are not in order, and poses that are no numbers."""
    for count, name in _COUNTED.items():
        if (arrays[count] < 0).any() or int(arrays[count].sum()) != len(arrays[name]):
            raise InputError(path, f"{count}: expected counts that sum to {len(arrays[name])}")
    if len(arrays["keys"]) and not (arrays["keys"][0] > 0 and (np.diff(arrays["keys"]) > 0).all()):
        raise InputError(path, "keys: expected numbers of key scans in ascending order")
    ends = arrays["path_firsts"] + arrays["path_counts"]
    before = np.concatenate([[0], ends[:-1]])
    if not ((arrays["path_firsts"] >= 0) & (arrays["path_firsts"] <= before)).all():
        raise InputError(path, "path_firsts: expected numbers of positions of the path before")
    for name in ("poses", "particles"):
        if not np.isfinite(arrays[name]).all():
            raise InputError(path, f"{name}: expected finite numbers")


def _check_moment(path: str | Path, number: int, moment: Moment) -> None:
    """Refuse tiles that cannot be unpacked."""
    try:
        if len(moment.at) * TILE_BYTES > 1 << 30:
            raise ValueError(f"{len(moment.at)} tiles at once")
        unpack_tiles(moment.tiles, len(moment.at))
    except ValueError as error:
        raise InputError(path, f"tiles of moment {number}: {error}") from None
