"""Occupancy grids: copy-on-write tiled maps, their distance fields, and the frame that world and cells share."""

from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_centres, cell_corner, cells_of
from gridslam.grid.tiles import TiledGrid, TileMaps

__all__ = ["LOG_ODDS_UNIT", "Evidence", "TileMaps", "TiledGrid", "cell_centres", "cell_corner", "cells_of"]
