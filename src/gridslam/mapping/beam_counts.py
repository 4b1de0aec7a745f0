"""Beam counts per cell, and the maps made of them: binary Bayes filter in closed form, and counting model."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_corner
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.types import BeamEnds, FloatArray, IntArray, OccupancyGrid

# A map in which a hit is +1, a miss -1 and nothing is occupied: after one scan it holds that scan's counts, because a
# cell in which a beam of the scan ends is not missed by the others.
_LIMIT: Final = 16_000  # hits or misses of one cell by one scan; what is beyond does not count
_ONE_EACH: Final = Evidence(*(LOG_ODDS_UNIT * steps for steps in (1, -1, -_LIMIT, _LIMIT, _LIMIT)))
_CERTAIN: Final = math.log(1e7)  # what was always or never reflected gets a probability 1e-7 off 1 or 0
_MOST_TILES: Final = 90_000  # 16 KB each, 1.5 GB in all: 230,000 m^2 in cells of 5 cm
_ROW: Final = np.zeros(1, np.int32)


@final
class BeamCounts:
    """Hits and misses of all observed cells.

    They are all that a map with known poses takes from the scans: sums, hence independent of the scans' order.

    Parameters
    ----------
    resolution_m : float, m
        Side of a cell.
    threads : int
        Threads of the kernels; never changes a result.
    """

    __slots__ = ("_hits", "_net", "_scan", "_slots")

    def __init__(self, resolution_m: float, threads: int = 1) -> None:
        self._scan = TileMaps(1, resolution_m=resolution_m, reach_cells=1.0, evidence=_ONE_EACH, threads=threads)
        self._slots: dict[tuple[int, int], int] = {}  # of each tile (row, column); 0 is the empty one
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
        reported = self._scan.tiles(ids[places[:, 0], places[:, 1]])
        self._scan.clear(0)
        slots = self._slots_of(places + corner)
        reported[reported == UNKNOWN] = 0
        self._hits[slots] += np.maximum(reported, 0)
        self._net[slots] += reported

    def table(self) -> tuple[IntArray, tuple[int, int]]:
        """Slots (R, C) of the rectangle of tiles that were observed, for `unfold`, and the (row, column) of its corner.

        0 is the empty slot; a single one at (0, 0) where nothing was observed.
        """
        if not self._slots:
            return np.zeros((1, 1), np.int64), (0, 0)
        tiles = np.array(list(self._slots))
        first = tiles.min(axis=0)
        slots = np.zeros(np.ptp(tiles, axis=0) + 1, np.int64)
        slots[tuple((tiles - first).T)] = list(self._slots.values())
        row, column = (TILE * first).tolist()
        return slots, (row, column)

    def unfold(self, slots: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return hits and misses (32 R, 32 C) of slots (R, C); both are 0 in cells that were not observed."""
        shape = tuple(TILE * side for side in slots.shape)
        hits, net = (counts[slots].swapaxes(1, 2).reshape(shape) for counts in (self._hits, self._net))
        return hits, np.maximum(hits - net, 0.0)

    def observed(self) -> tuple[FloatArray, FloatArray]:
        """Return hits and misses (S, 32, 32) of the S tiles that were observed; both are 0 in cells that were not."""
        hits, net = (counts[1 : len(self._slots) + 1] for counts in (self._hits, self._net))
        return hits, np.maximum(hits - net, 0.0)

    def _slots_of(self, tiles: IntArray) -> list[int]:
        """Return slots (K,) of tiles (K, 2) = [row, column], new ones where need be."""
        slots = [self._slots.setdefault((row, column), len(self._slots) + 1) for row, column in tiles.tolist()]
        if len(self._slots) >= _MOST_TILES:
            raise ArgumentError("poses", f"scans that observe less than {_MOST_TILES} tiles of 32 x 32 cells", "more")
        if len(self._slots) >= len(self._hits):
            shape = max(len(self._slots) + 1, min(len(self._hits) * 5 // 4, _MOST_TILES)), TILE, TILE
            self._hits.resize(shape, refcheck=False)  # in place: what is new holds 0
            self._net.resize(shape, refcheck=False)
        return slots


def bayes_map(counts: BeamCounts, inverse_sensor: InverseSensorModel) -> OccupancyGrid:
    """Give the occupancy that the binary Bayes filter ends with, from even odds.

    Each beam that ends in a cell adds the sensor's evidence of a hit to its log-odds, each that passes through it that
    of a miss. The clamps, which let a map that is being made unlearn, hold for the sum: so the order of the scans does
    not matter, and where no clamp is met it is the filter of SLAM.

    Source: Probabilistic Robotics, Tables 4.2 (`binary_bayes_filter`), 9.1 (`occupancy_grid_mapping`) and 9.2
    (`inverse_range_sensor_model`, of which a cell is hit or missed by its ray alone).
    """

    def believe(hits: FloatArray, misses: FloatArray) -> FloatArray:
        log_odds = hits * inverse_sensor.log_odds_hit + misses * inverse_sensor.log_odds_miss
        return np.clip(log_odds, inverse_sensor.log_odds_min, inverse_sensor.log_odds_max)

    return _unfold(counts, believe)


def counting_map(counts: BeamCounts) -> OccupancyGrid:
    """Compute the reflection probability of each cell: hits / (hits + misses).

    It is the maximum-likelihood estimate of how often the cell reflects a beam. That is no probability of being
    occupied: a railing that every second beam passes has 0.5, however long it was looked at, while the Bayes filter
    becomes certain of one or the other.

    Source: D. Haehnel, Mapping with Mobile Robots (2004), reflection probability maps.
    """

    def reflect(hits: FloatArray, misses: FloatArray) -> FloatArray:
        odds: FloatArray = np.divide(hits, misses, out=np.full(hits.shape, np.inf), where=misses > 0)
        with np.errstate(divide="ignore"):  # never hit: log 0
            return np.clip(np.log(odds), -_CERTAIN, _CERTAIN)

    return _unfold(counts, reflect)


def _unfold(counts: BeamCounts, log_odds_of: Callable[[FloatArray, FloatArray], FloatArray]) -> OccupancyGrid:
    """Map of the log-odds that are given for hits and misses; a row of tiles at a time, as counts take 16 bytes."""
    slots, corner = counts.table()
    shape = tuple(TILE * side for side in slots.shape) if slots.any() else (1, 1)
    log_odds = np.zeros(shape, np.float32)
    known = np.zeros(shape, np.bool_)
    for row, strip in enumerate(slots if slots.any() else []):
        hits, misses = counts.unfold(strip[None])
        cells = slice(row * TILE, (row + 1) * TILE)
        np.greater(hits + misses, 0, out=known[cells])
        log_odds[cells] = np.where(known[cells], log_odds_of(hits, misses), 0.0)
    return OccupancyGrid(log_odds, known, counts.resolution_m, cell_corner(*corner, counts.resolution_m))
