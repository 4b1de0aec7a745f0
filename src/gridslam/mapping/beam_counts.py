"""Beam counts per cell, and the maps made of them: binary Bayes filter in closed form, and counting model."""

from __future__ import annotations

import math
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_corner
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.types import BeamEnds, FloatArray, IntArray, OccupancyGrid

__all__ = ["BeamCounts", "bayes_map", "counting_map"]

# A map in which a hit is +1, a miss -1 and nothing is occupied: after one scan it holds that scan's counts, because a
# cell in which a beam of the scan ends is not missed by the others.
_LIMIT: Final = 16_000  # more beams than any scan has
_ONE_EACH: Final = Evidence(*(LOG_ODDS_UNIT * steps for steps in (1, -1, -_LIMIT, _LIMIT, _LIMIT)))
_CERTAIN: Final = math.log(1e7)  # what was always or never reflected gets a probability 1e-7 off 1 or 0
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

    __slots__ = ("_hits", "_kept", "_net", "_scan", "_slots")

    def __init__(self, resolution_m: float, half_life_scans: float | None = None, threads: int = 1) -> None:
        if half_life_scans is not None and not 0 < half_life_scans < math.inf:
            raise ArgumentError("half_life_scans", "a number of scans above 0, or None", half_life_scans)
        self._kept = 1.0 if half_life_scans is None else 0.5 ** (1 / half_life_scans)
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
        if not len(places):
            return
        reported = self._scan.tiles(ids[places[:, 0], places[:, 1]])
        self._scan.clear(0)
        slots = self._slots_of(places + corner)
        if self._kept < 1:
            kept = np.where(reported == UNKNOWN, 1.0, self._kept)
            self._hits[slots] *= kept
            self._net[slots] *= kept
        reported[reported == UNKNOWN] = 0
        self._hits[slots] += np.maximum(reported, 0)
        self._net[slots] += reported

    def rectangle(self) -> tuple[FloatArray, FloatArray, tuple[int, int]]:
        """Hits and misses (H, W) of all cells, and the (row, column) of their corner; one cell where nothing is known.

        Both are 0 in cells that were not observed.
        """
        if not self._slots:
            return np.zeros((1, 1)), np.zeros((1, 1)), (0, 0)
        tiles = np.array(list(self._slots))
        first = tiles.min(axis=0)
        slots = np.zeros(np.ptp(tiles, axis=0) + 1, np.int64)
        slots[tuple((tiles - first).T)] = list(self._slots.values())
        shape = tuple(TILE * side for side in slots.shape)
        hits, net = (counts[slots].swapaxes(1, 2).reshape(shape) for counts in (self._hits, self._net))
        row, column = (TILE * first).tolist()
        return hits, np.maximum(hits - net, 0.0), (row, column)

    def _slots_of(self, tiles: IntArray) -> list[int]:
        """Slots (K,) of tiles (K, 2) = [row, column], new ones where need be."""
        slots = [self._slots.setdefault((row, column), len(self._slots) + 1) for row, column in tiles.tolist()]
        while len(self._slots) >= len(self._hits):
            self._hits = np.concatenate([self._hits, np.zeros_like(self._hits)])
            self._net = np.concatenate([self._net, np.zeros_like(self._net)])
        return slots


def bayes_map(counts: BeamCounts, inverse_sensor: InverseSensorModel) -> OccupancyGrid:
    """Give the occupancy that the binary Bayes filter ends with, from even odds.

    Each beam that ends in a cell adds the sensor's evidence of a hit to its log-odds, each that passes through it that
    of a miss. The clamps, which let a map that is being made unlearn, hold for the sum: so the order of the scans does
    not matter, and where no clamp is met it is the filter of SLAM.

    Source: Probabilistic Robotics, Tables 4.2 (`binary_bayes_filter`), 9.1 (`occupancy_grid_mapping`) and 9.2
    (`inverse_range_sensor_model`, of which a cell is hit or missed by its ray alone).
    """
    hits, misses, corner = counts.rectangle()
    log_odds = hits * inverse_sensor.log_odds_hit + misses * inverse_sensor.log_odds_miss
    clamped = np.clip(log_odds, inverse_sensor.log_odds_min, inverse_sensor.log_odds_max).astype(np.float32)
    return _grid(counts, clamped, hits + misses > 0, corner)


def counting_map(counts: BeamCounts) -> OccupancyGrid:
    """Compute the reflection probability of each cell: hits / (hits + misses).

    It is the maximum-likelihood estimate of how often the cell reflects a beam. That is no probability of being
    occupied: a railing that every second beam passes has 0.5, however long it was looked at, while the Bayes filter
    becomes certain of one or the other.

    Source: D. Haehnel, Mapping with Mobile Robots (2004), reflection probability maps.
    """
    hits, misses, corner = counts.rectangle()
    known = hits + misses > 0
    odds = np.divide(hits, misses, out=np.full(hits.shape, np.inf), where=misses > 0)
    with np.errstate(divide="ignore"):  # never hit: log 0
        log_odds = np.clip(np.log(odds), -_CERTAIN, _CERTAIN)
    return _grid(counts, np.where(known, log_odds, 0.0).astype(np.float32), known, corner)


def _grid(
    counts: BeamCounts, log_odds: NDArray[np.float32], known: NDArray[np.bool_], corner: tuple[int, int]
) -> OccupancyGrid:
    return OccupancyGrid(log_odds, known, counts.resolution_m, cell_corner(*corner, counts.resolution_m))
