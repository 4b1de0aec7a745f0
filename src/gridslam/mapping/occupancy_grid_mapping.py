"""Occupancy grid mapping with known poses: the binary Bayes filter, one scan at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.grid.cells import Evidence
from gridslam.grid.tiles import MOST_TILES, TileMaps
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.parameters import bounded, parameters
from gridslam.types import Beams, Poses


@final
@checked
@parameters(frozen=True)
class OccupancyGridMapping:
    """Makes empty maps and inserts scans into them.

    Parameters
    ----------
    resolution_m : float, m, [0.01, 1]
        Side of a cell; 5 cm is what indoor robots navigate on.
    reach_cells : float, [1, 15.5]
        Distance, in cells, to which an obstacle attracts the ends of beams; half a metre at 5 cm.
    inverse_sensor : InverseSensorModel
        Evidence of a beam for the cells along it: for the first 1664, 83 m in cells of 5 cm, and for its end at any
        range.
    max_tiles : int
        Tiles, of 32 x 32 cells and 2 KB, that the maps of all particles take together at most, 1 GB by default; of 3 KB
        with an `inverse_sensor` whose evidence takes more than a byte (`gridslam.grid.Evidence`). A scan for which more
        would be needed raises ArgumentError, before anything is allocated for it.

    References
    ----------
    Probabilistic Robotics, Table 9.1 (`occupancy_grid_mapping`).
    """

    resolution_m: float = bounded(0.05, ge=0.01, le=1)
    reach_cells: float = bounded(10.5, ge=1, le=15.5)
    inverse_sensor: InverseSensorModel = InverseSensorModel()
    max_tiles: int = bounded(MOST_TILES, ge=1000, le=500_000_000)

    def empty(self, rows: int, threads: int = 1) -> TileMaps:
        """Return `rows` maps without known cells."""
        return TileMaps(rows, threads=threads, **self._form())

    def restore(self, arrays: Mapping[str, NDArray[Any]], threads: int = 1) -> TileMaps:
        """Make maps from the arrays of `TileMaps.to_arrays`; raises ArgumentError where they are no maps."""
        return TileMaps.from_arrays(arrays, threads=threads, **self._form())

    def _form(self) -> dict[str, Any]:
        model = self.inverse_sensor
        evidence = Evidence(
            model.log_odds_hit, model.log_odds_miss, model.log_odds_min, model.log_odds_max, model.log_odds_occupied
        )
        return {
            "resolution_m": self.resolution_m,
            "reach_cells": self.reach_cells,
            "evidence": evidence,
            "most_tiles": self.max_tiles,
        }

    def __call__(self, maps: TileMaps, poses: Poses, beams: Beams) -> None:
        """Insert one scan into every map, seen from its own pose of poses (rows, 3)."""
        maps.update(np.arange(len(maps), dtype=np.int32), poses, beams)
