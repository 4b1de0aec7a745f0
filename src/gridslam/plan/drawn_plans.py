"""Plans drawn by others, as PNG or DXF: the surfaces of their walls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from PIL import Image

from gridslam.errors import InputError, MissingDependencyError
from gridslam.geometry import se2
from gridslam.io.maps import map_pixels, read_map_image
from gridslam.io.text import read_text, refuse_unreadable
from gridslam.plan.alignment import Alignment
from gridslam.plan.surfaces import SurfacePoints, points_of_grid
from gridslam.types import FloatArray, OccupancyGrid

_STEP_M = 0.05
_LONGEST_M = 200_000.0


@final
class DrawnPlan(NamedTuple):
    """Lines or dark pixels of a plan, in its own units with y up.

    Attributes
    ----------
    path : Path
    lines : (S, 2, 2) float64
    grid : OccupancyGrid or None
        Dark pixels are occupied and others free; a pixel is 1 m.
    height : float or None
        Of an image, whose y is counted from the top.
    unit_m : float or None
        Length of a unit, m, where the file states it.
    """

    path: Path
    lines: FloatArray
    grid: OccupancyGrid | None = None
    height: float | None = None
    unit_m: float | None = None

    def turn_up(self, places: FloatArray) -> FloatArray:
        """Places (N, 2) as the file's programs show them, with y up."""
        return places if self.height is None else np.column_stack([places[:, 0], self.height - places[:, 1]])

    def surfaces(self, unit_m: float) -> SurfacePoints:
        """Points on walls, m; of lines to their left, as it is not known which side is free."""
        if self.grid is not None:
            return points_of_grid(replace(self.grid, resolution_m=unit_m))
        ends = unit_m * self.lines
        apart = ends[:, 1] - ends[:, 0]
        total_m = float(np.hypot(*apart.T).sum())
        if not total_m < _LONGEST_M:
            raise InputError(self.path, f"expected lines of less than {_LONGEST_M:g} m in all, got {total_m:g}")
        counts = np.maximum(1, np.round(np.hypot(*apart.T) / _STEP_M)).astype(np.int64)
        numbers = np.repeat(np.arange(len(ends)), counts)
        steps = (np.arange(len(numbers)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[numbers]
        places = ends[numbers, 0] + steps[:, None] * apart[numbers]
        normals = np.column_stack([-apart[:, 1], apart[:, 0]]) / np.maximum(np.hypot(*apart.T), 1e-12)[:, None]
        return SurfacePoints(places, normals[numbers], np.ones(len(places)))


def read_drawn_plan(path: Path) -> DrawnPlan:
    """Read the lines of a DXF, or the dark pixels of an image.

    Raises
    ------
    InputError
        The file cannot be read, or shows no line.
    MissingDependencyError
        ezdxf, of the extra ``map``, is not installed.
    """
    plan = _read_dxf(path) if path.suffix.lower() == ".dxf" else _read_image(path)
    if plan.grid is None and not len(plan.lines):
        raise InputError(path, "expected a plan with lines, got one without")
    if plan.grid is None and not np.isfinite(plan.lines).all():
        raise InputError(path, "expected a plan with finite places")
    return plan


def draw_aligned(grid: OccupancyGrid, alignment: Alignment, plan: SurfacePoints) -> Image.Image:
    """Paint the plan's walls red on the map."""
    pixels = np.repeat(map_pixels(grid)[:, :, None], 3, axis=2)
    places = se2.transform_points(se2.inverse(alignment.pose), plan.positions) / alignment.scale
    column, row = np.floor((places - grid.origin) / grid.resolution_m).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < grid.shape[0]) & (column < grid.shape[1])
    pixels[row[inside], column[inside]] = 214, 40, 40
    return Image.fromarray(pixels[::-1])


def _read_image(path: Path) -> DrawnPlan:
    """Take pixels darker than half as walls."""
    image = read_map_image(path)
    dark = ((image.brightness < 128) & image.opaque)[::-1]
    log_odds = np.where(dark, 4.0, -4.0).astype(np.float32)
    grid = OccupancyGrid(log_odds, np.ones(dark.shape, np.bool_), 1.0, (0.0, 0.0))
    return DrawnPlan(path, np.zeros((0, 2, 2)), grid, float(len(dark)))


def _read_dxf(path: Path) -> DrawnPlan:
    """Take lines, polylines, arcs, circles and ellipses of the modelspace, in its units."""
    try:
        from ezdxf import units
        from ezdxf.enums import InsertUnits
        from ezdxf.filemanagement import read
    except ImportError:
        raise MissingDependencyError("DXF", "ezdxf", "map") from None
    text = read_text(path)
    with refuse_unreadable(path, "DXF"):
        drawing = read(StringIO(text))
        lines = [segment for entity in drawing.modelspace() for segment in _lines_of(entity)]
        unit_m = units.conversion_factor(InsertUnits(drawing.units), InsertUnits.Meters) if drawing.units else None
    return DrawnPlan(path, np.array(lines, np.float64).reshape(-1, 2, 2), None, None, unit_m)


def _lines_of(entity: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401
    """Segments of an entity, on a curve a degree to 12 degrees long each."""
    from ezdxf.path import make_path

    is_mesh = entity.dxftype() == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh)
    if entity.dxftype() not in _DRAWN or is_mesh:  # a mesh is furniture
        return
    path = make_path(entity)
    corners = np.array([tuple(corner)[:2] for corner in path.control_vertices()], np.float64)
    size = float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0
    if not math.isfinite(size):
        raise ValueError(f"a {entity.dxftype()} that is not finite")
    points = [tuple(p)[:2] for p in path.flattening(max(1e-3 * size, 1e-9), segments=4)]
    yield from pairwise(points)


_DRAWN = "LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE"
SUFFIXES = (".dxf", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")
