"""Plans drawn by others, as images: the surfaces of their walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.io.maps import map_pixels, read_map_image
from gridslam.plan.alignment import Alignment
from gridslam.plan.surfaces import SurfacePoints, points_of_grid
from gridslam.types import OccupancyGrid

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")


def read_drawn_plan(path: Path, unit_m: float | None) -> SurfacePoints:
    """Read points on the walls of a plan, m with y up: its dark pixels, of side `unit_m`.

    Raises InputError where the file cannot be read, or no length is given.
    """
    if unit_m is None:
        raise InputError(path, "expected a plan with a scale: state --unit METRES of its pixels")
    image = read_map_image(path)
    dark = ((image.brightness < 128) & image.opaque)[::-1]
    log_odds = np.where(dark, 4.0, -4.0).astype(np.float32)
    return points_of_grid(OccupancyGrid(log_odds, np.ones(dark.shape, np.bool_), unit_m, (0.0, 0.0)))


def draw_aligned(grid: OccupancyGrid, alignment: Alignment, plan: SurfacePoints) -> Image.Image:
    """Paint the plan's walls red on the map."""
    pixels = np.repeat(map_pixels(grid)[:, :, None], 3, axis=2)
    places = se2.transform_points(se2.inverse(alignment.pose), plan.positions) / alignment.scale
    column, row = np.floor((places - grid.origin) / grid.resolution_m).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < grid.shape[0]) & (column < grid.shape[1])
    pixels[row[inside], column[inside]] = 214, 40, 40
    return Image.fromarray(pixels[::-1])
