"""Beam counts per cell: number of beams that end in it, and that pass through it."""

from __future__ import annotations

import math
from typing import Final, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.grid.evidence import LOG_ODDS_UNIT, Evidence
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.types import BeamEnds, FloatArray, IntArray

__all__ = ["BeamCounts"]

# A map in which a hit is +1, a miss -1 and nothing is occupied: after one scan it holds that scan's counts, because a
# cell in which a beam of the scan ends is not missed by the others.
_LIMIT: Final = 16_000  # more beams than any scan has
_ONE_EACH: Final = Evidence(*(LOG_ODDS_UNIT * steps for steps in (1, -1, -_LIMIT, _LIMIT, _LIMIT)))
_ROW: Final = np.zeros(1, np.int32)


@final
class BeamCounts:
    """Hits and misses of all observed cells.

    They are all that a map with known poses takes from the scans: sums, hence independent of the scans' order.

    Parameters
    ----------
    resolution_m : float, m
        Side of a cell.
    half_life_scans : float or None, > 0
        Number of scans observing a cell after which the weight of its counts is halved; None for no decay. Counts of a
        cell that is not observed do not decay.
    threads : int
        Threads of the kernels; never changes a result.
    """

    __slots__ = ("_first", "_hits", "_kept", "_net", "_scan", "_slots", "_used")

    def __init__(self, resolution_m: float, half_life_scans: float | None = None, threads: int = 1) -> None:
        if half_life_scans is not None and not 0 < half_life_scans < math.inf:
            raise ArgumentError("half_life_scans", "a number of scans above 0, or None", half_life_scans)
        self._kept = 1.0 if half_life_scans is None else 0.5 ** (1 / half_life_scans)
        self._scan = TileMaps(1, resolution_m=resolution_m, reach_cells=1.0, evidence=_ONE_EACH, threads=threads)
        self._slots: IntArray = np.zeros((0, 0), np.int64)  # of the tiles in a rectangle; 0 where there is none
        self._first: IntArray = np.zeros(2, np.int64)  # row and column of its first tile
        self._used = 1
        self._hits: FloatArray = np.zeros((64, TILE, TILE))
        self._net: FloatArray = np.zeros((64, TILE, TILE))  # hits less misses

    @property
    def resolution_m(self) -> float:
        """Side of a cell."""
        return self._scan.resolution_m

    def add(self, pose: FloatArray, beams: BeamEnds) -> None:
        """Count the beams of one scan, seen from a pose (3,)."""
        self._scan.update(_ROW, pose[None], beams)
        ids, corner = self._scan.tile_ids(0)
        places = np.argwhere(ids)
        if not len(places):
            return
        told = self._scan.tiles(ids[places[:, 0], places[:, 1]])
        self._scan.clear(0)
        slots = self._slots_of(places + corner)
        if self._kept < 1:
            kept = np.where(told == UNKNOWN, 1.0, self._kept)
            self._hits[slots] *= kept
            self._net[slots] *= kept
        told[told == UNKNOWN] = 0
        self._hits[slots] += np.maximum(told, 0)
        self._net[slots] += told

    def rectangle(self) -> tuple[FloatArray, FloatArray, tuple[int, int]]:
        """Hits and misses (H, W) of all cells, and the (row, column) of their corner; one cell where nothing is known.

        Both are 0 in cells that were not observed.
        """
        if not self._slots.size:
            return np.zeros((1, 1)), np.zeros((1, 1)), (0, 0)
        shape = tuple(TILE * side for side in self._slots.shape)
        hits, net = (tiles[self._slots].swapaxes(1, 2).reshape(shape) for tiles in (self._hits, self._net))
        row, column = (TILE * self._first).tolist()
        return hits, np.maximum(hits - net, 0.0), (row, column)

    def _slots_of(self, tiles: IntArray) -> IntArray:
        """Slots (K,) of tiles (K, 2) = [row, column], new ones where need be."""
        low, high = tiles.min(axis=0), tiles.max(axis=0) + 1
        if not self._slots.size:
            self._first = low
        first = np.minimum(low, self._first)
        last = np.maximum(high, self._first + self._slots.shape)
        if (last - first > self._slots.shape).any():
            above, left = (self._first - first).tolist()
            below, right = (last - self._first - self._slots.shape).tolist()
            self._slots, self._first = np.pad(self._slots, ((above, below), (left, right))), first
        at = tuple((tiles - self._first).T)
        slots: IntArray = self._slots[at]
        new = np.flatnonzero(slots == 0)
        slots[new] = self._used + np.arange(len(new))
        self._slots[at] = slots
        self._used += len(new)
        while self._used > len(self._hits):
            self._hits = np.concatenate([self._hits, np.zeros_like(self._hits)])
            self._net = np.concatenate([self._net, np.zeros_like(self._net)])
        return slots
