"""The map as it is published, written and shown."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Protocol, final, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import freeze, require_array, require_instance
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.scan import FloatArray

_UNKNOWN = 205
_MOST_PX = 1000


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """A rectangular map, as it is published and written.

    Attributes
    ----------
    log_odds : (H, W) float32, nats
        Log-odds of occupancy; meaningful where `known`.
    known : (H, W) bool
        Whether the cell was observed.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        World coordinates of the lower left corner of cell [0, 0].
    """

    log_odds: NDArray[np.float32]
    known: NDArray[np.bool_]
    resolution_m: float
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        """Check that all belongs together."""
        require_instance("log_odds", self.log_odds, np.ndarray)
        if self.log_odds.ndim != 2:
            raise ArgumentError("log_odds", "shape (H, W)", self.log_odds.shape)
        require_array("known", self.known, np.bool_, self.log_odds.shape)
        if not 0 < self.resolution_m < math.inf:
            raise ArgumentError("resolution_m", "a finite length > 0 m", self.resolution_m)
        freeze(self.origin, np.float64, (2,), "origin")

    def __repr__(self) -> str:
        """Return one line."""
        height, width = self.known.shape
        cell_m = self.resolution_m
        known = f"{self.known.mean():.0%} known" if self.known.any() else "no cell known"
        sides = f"{width * cell_m:.1f} m x {height * cell_m:.1f} m"
        return f"OccupancyGrid({width} x {height} cells of {cell_m:g} m, {sides}, {known})"

    def _repr_png_(self) -> bytes | None:
        """Picture for notebooks: occupied is black, free white, unknown grey, the first row at the bottom."""
        if not self.known.size:
            return None
        levels = np.where(self.known, np.clip(255 * (1 - self.probability), 0, 255), np.inf)
        return encode_grey(np.where(np.isinf(shrunk := _darkest(levels)), _UNKNOWN, shrunk).astype(np.uint8)[::-1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        height, width = self.known.shape
        return height, width

    def rows(self, first: int, last: int) -> OccupancyGrid:
        """Return rows `first` to `last` - 1, sharing the arrays."""
        x, y = self.origin
        origin = x, y + first * self.resolution_m
        return OccupancyGrid(self.log_odds[first:last], self.known[first:last], self.resolution_m, origin)

    @property
    def probability(self) -> NDArray[np.float32]:
        """Occupancy probability (H, W); 0.5 where unknown."""
        odds = np.where(self.known, self.log_odds, np.float32(0))
        return (1.0 / (1.0 + np.exp(-odds))).astype(np.float32)


@runtime_checkable
class GridRows(Protocol):
    """A rectangular map that may be had a few rows at a time: an `OccupancyGrid`, or one that stays in its tiles."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        ...

    @property
    def resolution_m(self) -> float:
        """Side of a cell."""
        ...

    @property
    def origin(self) -> tuple[float, float]:
        """World coordinates (m) of the lower left corner of cell [0, 0]."""
        ...

    def rows(self, first: int, last: int) -> OccupancyGrid:
        """Return rows `first` to `last` - 1."""
        ...


def _darkest(levels: FloatArray) -> FloatArray:
    """Levels (H, W) in blocks so large that neither side has more than `_MOST_PX`: the least of each block stays."""
    block = -(-max(levels.shape) // _MOST_PX)
    height, width = levels.shape
    rows = np.minimum.reduceat(levels, np.arange(0, height, block))
    return np.minimum.reduceat(rows, np.arange(0, width, block), axis=1)


def encode_grey(pixels: NDArray[np.uint8]) -> bytes:
    """PNG of brightnesses (H, W), both at least 1, the first row at the top.

    Source: PNG specification, third edition, sections 5.2 to 5.6, 9.2 and 11.2.
    """
    height, width = pixels.shape
    lines = np.pad(pixels, [(0, 0), (1, 0)])  # each line begins with its filter: 0, none
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes())), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
