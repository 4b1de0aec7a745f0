"""The messages to the page: a JSON header and plain arrays, compressed together.

A message is zlib(N, header, data): N is a little-endian uint32, the header N bytes of UTF-8 JSON (padded by spaces, so
that the data begin at a multiple of 4), and the data are the arrays that the header lists under ``arrays`` as [name,
dtype, shape], little-endian, one after the other, each padded to a multiple of 4 bytes.

A map is sent in levels, 0 for an unknown cell and 1 to 15 for log-odds in steps of `STEP_NATS`, 8 being even odds. They
saturate early, so a tile that was observed a few times does not change any more.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.cells import LOG_ODDS_UNIT
from gridslam.kernels import TILE, UNKNOWN

Float32Array: TypeAlias = NDArray[np.float32]

NO_POINTS: Float32Array = np.zeros((0, 2), np.float32)

STEP_NATS = 0.2
"""Log-odds between two levels."""

_SPEED = 5  # of zlib: beyond it maps get 2 % smaller at twice the time


def encode(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Write a message; the arrays must be of fixed size items, the header of JSON values without NaN."""
    listed = [[name, array.dtype.str[1:], array.shape] for name, array in arrays.items()]
    text = json.dumps({**header, "arrays": listed}, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    packer = zlib.compressobj(_SPEED)
    parts = [packer.compress(struct.pack("<I", len(text)) + text)]
    for array in arrays.values():
        data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        parts.append(packer.compress(data + bytes(-len(data) % 4)))
    return b"".join([*parts, packer.flush()])


_STEP = round(STEP_NATS / LOG_ODDS_UNIT)
_LOWEST = -7 * _STEP - _STEP // 2  # of level 1
_HIGHEST = _LOWEST + 15 * _STEP - 1  # of level 15


def levels(log_odds: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Return levels (...) of stored log-odds (...), 0 to 15."""
    found = np.clip(log_odds, np.int16(_LOWEST), np.int16(_HIGHEST))
    found -= np.int16(_LOWEST - _STEP)
    found //= np.int16(_STEP)
    found *= log_odds != UNKNOWN
    return found.astype(np.uint8)


def pack_tiles(tiles: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return levels (K, 32, 32) as (K, 512) bytes: of two neighbours in a row the first is in the lower four bits."""
    pairs = np.ascontiguousarray(tiles).reshape(len(tiles), TILE * TILE).view("<u2")
    both: NDArray[np.uint8] = (pairs | pairs >> np.uint16(4)).astype(np.uint8)
    return both
