"""Maps of counted beams: the binary Bayes filter in its closed form, and the counting model."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.frame import cell_corner
from gridslam.mapping.beam_counts import BeamCounts
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.types import OccupancyGrid

__all__ = ["bayes_map", "counting_map"]

_CERTAIN: Final = math.log(1e7)  # what was always or never reflected gets a probability 1e-7 off 1 or 0


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
