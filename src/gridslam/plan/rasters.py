"""The cells of a map for the plan: floor, objects on it, and free space at given points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridslam.plan.untyped import ndimage
from gridslam.types import FloatArray, OccupancyGrid

BoolArray: TypeAlias = NDArray[np.bool_]

_LONGEST_FURNITURE_M = 4.0
_SHORTEST_WALL_M = 0.9
_THICKEST_WALL_M = 0.25
"""Things that stand alone, but are thinner and longer than this, are walls between two doors."""
_MOST_CELLS = 13_000_000
"""Of larger maps two cells are one, or three: rooms are searched for in cells of 10 cm on 500 m x 250 m."""


@final
@dataclass(frozen=True, eq=False)
class Raster:
    """Cells of a map.

    Attributes
    ----------
    free, occupied, furniture : (H, W) bool
        What is free, what is occupied, and what stands alone amid what is free: no larger than furniture is.
    cell_m : float
        Side of a cell.
    origin : (2,) float64, m
        Lower left corner of cell [0, 0].
    """

    free: BoolArray
    occupied: BoolArray
    furniture: BoolArray
    cell_m: float
    origin: FloatArray

    @property
    def floor(self) -> BoolArray:
        """Return free cells, and those on which furniture stands (H, W)."""
        return self.free | self.furniture

    @cached_property
    def beside_occupied(self) -> BoolArray:
        """Return cells (H, W) of which one within two is occupied."""
        return dilate(self.occupied, 2)

    def cells(self, points: FloatArray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the cells of points (N, 2); those outside get the nearest."""
        column, row = np.floor((np.atleast_2d(points) - self.origin) / self.cell_m).astype(np.int64).T
        height, width = self.free.shape
        return row.clip(0, height - 1), column.clip(0, width - 1)

    def points(self, cells: np.ndarray) -> FloatArray:
        """Middles (N, 2) of cells (N, 2), rows and columns, m."""
        return self.origin + (cells[:, ::-1] + 0.5) * self.cell_m

    def is_vacated(self, points: FloatArray) -> BoolArray:
        """Whether each of points (N, 2) is in a free cell without an occupied one beside it: who was there has gone."""
        row, column = self.cells(points)
        beside = dilate(self.occupied, 1)
        return np.asarray(self.free[row, column] & ~beside[row, column], np.bool_)

    def share_free(self, points: FloatArray) -> float:
        """Share of points (N, 2) that are in free cells."""
        return float(self.free[self.cells(points)].mean())

    def is_furniture(self, point: FloatArray) -> bool:
        """Whether furniture is at a point (2,)."""
        return bool(self.furniture[self.cells(point)][0])


def make_raster(grid: OccupancyGrid) -> Raster:
    """Convert a map to cells, larger ones for a large map, and find isolated objects."""
    free, occupied = grid.known & (grid.log_odds < 0), grid.known & (grid.log_odds > 0)
    factor = int(np.ceil(np.sqrt(free.size / _MOST_CELLS)))
    cell_m = grid.resolution_m
    if factor > 1:
        free, occupied = (_shrink(cells, factor) for cells in (free, occupied))
        free &= ~occupied
        cell_m *= factor
    labels, _ = ndimage.label(~np.pad(free, 1), np.ones((3, 3)))  # the margin joins all that is outside
    labels = labels[1:-1, 1:-1]
    sizes = np.bincount(labels.reshape(-1)) * cell_m**2
    lengths = [0.0] + [cell_m * np.hypot(*(s.stop - s.start for s in part)) for part in ndimage.find_objects(labels)]
    is_furniture = [
        length <= _LONGEST_FURNITURE_M and not (length > _SHORTEST_WALL_M and size / length < _THICKEST_WALL_M)
        for length, size in zip(lengths, sizes, strict=True)
    ]
    is_furniture[0] = False
    return Raster(free, occupied, np.array(is_furniture)[labels], cell_m, np.array(grid.origin))


def _shrink(cells: BoolArray, factor: int) -> BoolArray:
    """Make blocks of cells one, set where one of them is."""
    margins = [(0, -side % factor) for side in cells.shape]
    padded = np.pad(cells, margins)
    height, width = (side // factor for side in padded.shape)
    return np.asarray(padded.reshape(height, factor, width, factor).any(axis=(1, 3)), np.bool_)


def dilate(cells: BoolArray, reach: int) -> BoolArray:
    """Set the cells (H, W) within a square of `reach` cells about those that are set."""
    return np.asarray(ndimage.maximum_filter(cells.view(np.uint8), 2 * reach + 1).view(np.bool_))


def erode(cells: BoolArray, reach: int) -> BoolArray:
    """Leave the cells (H, W) about which all are set within a square of `reach` cells; beyond the edge none is."""
    return ~dilate(np.pad(~cells, reach, constant_values=True), reach)[reach:-reach, reach:-reach]


def fill_polygons(raster: Raster, polygons: list[FloatArray]) -> BoolArray:
    """Cells (H, W) in polygons (K, 2), m; two points are a line two cells wide."""
    height, width = raster.free.shape
    image = Image.new("1", (width, height))
    draw = ImageDraw.Draw(image)
    for polygon in polygons:
        corners = [tuple(corner) for corner in ((polygon - raster.origin) / raster.cell_m - 0.5).tolist()]
        if len(corners) == 2:
            draw.line(corners, fill=1, width=2)
        else:
            draw.polygon(corners, fill=1, outline=1)
    return np.asarray(image, np.bool_).copy()
