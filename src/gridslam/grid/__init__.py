"""Occupancy grids: copy-on-write tiled maps, their distance fields, and the frame that world and cells share."""

from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_centres, cells_of
from gridslam.grid.tiles import TileMaps

__all__ = ["LOG_ODDS_UNIT", "Evidence", "TileMaps", "cell_centres", "cells_of"]
