"""Occupancy grids: copy-on-write tiled maps, their distance fields, and the frame that world and cells share."""

from gridslam.grid.evidence import LOG_ODDS_UNIT, Evidence
from gridslam.grid.frame import cell_centres, cell_corner, cells_of
from gridslam.grid.tiled_grid import TiledGrid
from gridslam.grid.tiles import TileMaps

__all__ = ["LOG_ODDS_UNIT", "Evidence", "TileMaps", "TiledGrid", "cell_centres", "cell_corner", "cells_of"]
