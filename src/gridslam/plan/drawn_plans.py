"""Plans drawn by others, as images or DXF: the surfaces of their walls."""

from __future__ import annotations

from collections.abc import Iterator
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

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
_DRAWN = "LINE LWPOLYLINE POLYLINE ARC CIRCLE ELLIPSE"
SUFFIXES = (".dxf", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")


def read_drawn_plan(path: Path, unit_m: float | None = None) -> tuple[SurfacePoints, float]:
    """Read points on the walls of a plan, m with y up, and the length of its unit, m.

    Walls are the lines of a DXF, whose normals are to their left, as it is not known which side is free, or the dark
    pixels of an image.

    Parameters
    ----------
    path : Path
    unit_m : float, m, optional
        Length of a pixel or a unit; needed unless a DXF states it.

    Raises
    ------
    InputError
        The file cannot be read, shows no line, or has no unit.
    MissingDependencyError
        ezdxf, of the extra ``map``, is not installed.
    """
    is_dxf = path.suffix.lower() == ".dxf"
    if is_dxf:
        lines, stated_m = _read_lines(path)
        unit_m = unit_m or stated_m
    if unit_m is None:
        raise InputError(path, "expected a plan with a scale: state --unit METRES of its pixels or units")
    return (_points_of_lines(path, np.asarray(unit_m * lines)) if is_dxf else _read_image(path, unit_m)), unit_m


def draw_aligned(grid: OccupancyGrid, alignment: Alignment, plan: SurfacePoints) -> Image.Image:
    """Paint the plan's walls red on the map."""
    pixels = np.repeat(map_pixels(grid)[:, :, None], 3, axis=2)
    places = se2.transform_points(se2.inverse(alignment.pose), plan.positions) / alignment.scale
    column, row = np.floor((places - grid.origin) / grid.resolution_m).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < grid.shape[0]) & (column < grid.shape[1])
    pixels[row[inside], column[inside]] = 214, 40, 40
    return Image.fromarray(pixels[::-1])


def _read_image(path: Path, unit_m: float) -> SurfacePoints:
    """Take pixels darker than half as walls."""
    image = read_map_image(path)
    dark = ((image.brightness < 128) & image.opaque)[::-1]
    log_odds = np.where(dark, 4.0, -4.0).astype(np.float32)
    return points_of_grid(OccupancyGrid(log_odds, np.ones(dark.shape, np.bool_), unit_m, (0.0, 0.0)))


def _points_of_lines(path: Path, ends: FloatArray) -> SurfacePoints:
    """Points every 5 cm of lines (S, 2, 2), m."""
    apart = ends[:, 1] - ends[:, 0]
    lengths = np.hypot(*apart.T)
    if not 0 < lengths.sum() < _LONGEST_M:
        raise InputError(path, f"expected lines of up to {_LONGEST_M:g} m in all, got {lengths.sum():g} m")
    counts = np.maximum(1, np.round(lengths / _STEP_M)).astype(np.int64)
    numbers = np.repeat(np.arange(len(ends)), counts)
    steps = (np.arange(len(numbers)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[numbers]
    normals = np.column_stack([-apart[:, 1], apart[:, 0]]) / np.maximum(lengths, 1e-12)[:, None]
    places = ends[numbers, 0] + steps[:, None] * apart[numbers]
    return SurfacePoints(places, normals[numbers], np.ones(len(places)))


def _read_lines(path: Path) -> tuple[FloatArray, float | None]:
    """Read lines (S, 2, 2), polylines, arcs, circles and ellipses of a DXF's modelspace, and its unit, m."""
    try:
        from ezdxf import units
        from ezdxf.enums import InsertUnits
        from ezdxf.filemanagement import read
    except ImportError:
        raise MissingDependencyError("DXF", "ezdxf", "map") from None
    text = read_text(path)
    with refuse_unreadable(path, "DXF"):
        drawing = read(StringIO(text))
        lines = [segment for entity in drawing.modelspace().query(_DRAWN) for segment in _lines_of(entity)]
        unit_m = units.conversion_factor(InsertUnits(drawing.units), InsertUnits.Meters) if drawing.units else None
    return np.array(lines, np.float64).reshape(-1, 2, 2), unit_m


def _lines_of(entity: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401
    """Segments of an entity, on a curve a degree to 12 degrees long each."""
    from ezdxf.path import make_path

    if entity.dxftype() == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh):
        return  # furniture
    path = make_path(entity)
    corners = np.array([tuple(corner)[:2] for corner in path.control_vertices()], np.float64)
    size = float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0
    if not np.isfinite(size):
        raise ValueError(f"a {entity.dxftype()} that is not finite")
    yield from pairwise(tuple(p)[:2] for p in path.flattening(max(1e-3 * size, 1e-9), segments=4))
