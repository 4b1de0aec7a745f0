"""The YAML file of a map_server map: a flat list of keys, read without a YAML library."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import final

from gridslam.errors import InputError
from gridslam.io.text import read_text

__all__ = ["FREE_THRESH", "OCCUPIED_THRESH", "MapDescription", "read_map_description"]

OCCUPIED_THRESH = 0.65
FREE_THRESH = 0.196

_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")
_FINEST_M, _COARSEST_M = 0.001, 10.0  # what lies outside is another unit, or a slip
_Entries = dict[str, tuple[str, int]]


@final
@dataclass(frozen=True, slots=True)
class MapDescription:
    """Content of map.yaml.

    Attributes
    ----------
    image : str
        Path of the image, relative to the YAML file.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        Lower left corner of the map.
    negate : bool
        Whether white is occupied.
    occupied_thresh, free_thresh : float
        Probabilities above and below which a pixel is occupied and free.
    mode : str
        "trinary", "scale" or "raw".
    """

    image: str
    resolution_m: float
    origin: tuple[float, float]
    negate: bool = False
    occupied_thresh: float = OCCUPIED_THRESH
    free_thresh: float = FREE_THRESH
    mode: str = "trinary"

    def to_yaml(self) -> str:
        """Text of the YAML file."""
        plain = self.image.replace(".", "").replace("_", "").replace("-", "").isalnum()
        name = self.image if plain else "'" + self.image.replace("'", "''") + "'"
        return (
            f"image: {name}\nmode: {self.mode}\nresolution: {self.resolution_m!r}\n"
            f"origin: [{self.origin[0]!r}, {self.origin[1]!r}, 0.0]\nnegate: {int(self.negate)}\n"
            f"occupied_thresh: {self.occupied_thresh!r}\nfree_thresh: {self.free_thresh!r}\n"
        )


def read_map_description(path: str | Path) -> MapDescription:
    """Read a map's YAML file; keys that map_server does not know are left out, as there.

    Raises
    ------
    InputError
        With the line, where a value is not what its key needs or a line is no ``key: value``; where a key is missing.
    """
    entries = _entries(path)
    missing = [key for key in _REQUIRED if key not in entries]
    if missing:
        raise InputError(path, f"expected the keys {', '.join(_REQUIRED)}, got none named {', '.join(missing)}")
    resolution = _number(path, entries, "resolution")
    if not _FINEST_M <= resolution <= _COARSEST_M:
        problem = f"expected a resolution from {_FINEST_M:g} to {_COARSEST_M:g} m, got {resolution:g}"
        raise InputError(path, problem, entries["resolution"][1])
    low, high = _number(path, entries, "free_thresh"), _number(path, entries, "occupied_thresh")
    if not 0 <= low < high <= 1:
        problem = f"expected 0 <= free_thresh < occupied_thresh <= 1, got {low:g} and {high:g}"
        raise InputError(path, problem, entries["free_thresh"][1])
    mode, line = entries.get("mode", ("trinary", 0))
    if mode not in _MODES:
        raise InputError(path, f"expected the mode {', '.join(_MODES)}, got {mode!r}", line)
    negate, line = entries["negate"]
    if negate.lower() not in ("0", "1", "false", "true"):
        raise InputError(path, f"expected negate 0 or 1, got {negate!r}", line)
    negated = negate.lower() in ("1", "true")
    return MapDescription(entries["image"][0], resolution, _origin(path, *entries["origin"]), negated, high, low, mode)


def _entries(path: str | Path) -> _Entries:
    """Value and line of each key; a list of ``- item`` lines below its key becomes one in brackets."""
    entries: _Entries = {}
    key = ""
    for number, raw in enumerate(read_text(path).splitlines(), 1):
        line = (raw if "'" in raw or '"' in raw else raw.split(" #")[0]).strip()
        if not line or line.startswith("#") or line in ("---", "..."):
            continue
        if line.startswith("- ") and key and (entries[key][0] == "" or entries[key][0].startswith("[")):
            items = entries[key][0].strip("[]")
            entries[key] = (f"[{items}, {line[2:].strip()}]" if items else f"[{line[2:].strip()}]", entries[key][1])
            continue
        key, colon, value = (part.strip() for part in line.partition(":"))
        if not colon or not key or raw[0].isspace():
            raise InputError(path, f"expected 'key: value', got {raw!r}", number)
        if key in entries:
            raise InputError(path, f"expected each key once, got {key} again", number)
        entries[key] = (_unquoted(value), number)
    return entries


def _unquoted(value: str) -> str:
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1].replace("''", "'")
    if len(value) >= 2 and value[0] == value[-1] == '"':
        return value[1:-1].replace('\\"', '"').replace("\\\\", "\\")
    return value


def _number(path: str | Path, entries: _Entries, key: str) -> float:
    value, line = entries[key]
    return _finite(path, key, value, line)


def _finite(path: str | Path, key: str, value: str, line: int) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(path, f"expected a number for {key}, got {value!r}", line)
    return number


def _origin(path: str | Path, value: str, line: int) -> tuple[float, float]:
    words = value[1:-1].split(",") if value.startswith("[") and value.endswith("]") else []
    if len(words) != 3:
        raise InputError(path, f"expected origin: [x, y, yaw], got {value!r}", line)
    x, y, yaw = (_finite(path, "origin", word, line) for word in words)
    if yaw != 0:
        raise InputError(path, f"expected a map that is not rotated (yaw 0), got yaw {yaw:g}", line)
    return x, y
