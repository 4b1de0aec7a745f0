"""Plans drawn by others, as PNG, SVG or DXF: the surfaces of their walls."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple, final
from xml.etree import ElementTree

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
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_PATH = re.compile(r"([MmLlHhVvZzCcSsQqTtAa])([^MmLlHhVvZzCcSsQqTtAa]*)")
_CHANGE = re.compile(r"(matrix|translate|scale|rotate)\s*\(([^)]*)\)")
_TAKEN = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7}
"""Numbers of each command of a path; curves are taken as lines between their ends."""


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
        Of a plan whose y is counted from the top, as pixels are.
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
    """Read the lines of a DXF or an SVG, or the dark pixels of an image.

    Raises
    ------
    InputError
        The file cannot be read, or shows no line.
    MissingDependencyError
        ezdxf, of the extra ``map``, is not installed.
    """
    plan = _READERS.get(path.suffix.lower(), _read_image)(path)
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
    yield from _join(points, False)


def _join(points: list[Any], is_closed: bool) -> Iterator[tuple[Any, Any]]:
    yield from zip(points, points[1:] + points[:1] * is_closed, strict=False)


def _read_svg(path: Path) -> DrawnPlan:
    """Take lines, rectangles, polygons and paths of an SVG, where they are transformed to."""
    text = read_text(path)
    if "<!ENTITY" in text:
        raise InputError(path, "expected an SVG without entities of its own")
    with refuse_unreadable(path, "SVG"):
        root = ElementTree.fromstring(text)
        box = _numbers(root.get("viewBox", "")) or [0.0, 0.0, 0.0, *_numbers(root.get("height", "0"))[:1]]
        height = box[1] + box[3]
        lines = [segment for segments in _walk(root, np.eye(3)) for segment in segments]
    found = np.array(lines, np.float64).reshape(-1, 2, 2)
    found[..., 1] = height - found[..., 1]
    return DrawnPlan(path, found, None, height)


def _numbers(text: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(text)]


def _walk(root: ElementTree.Element, outer: FloatArray) -> Iterator[list[FloatArray]]:
    """Yield segments (2, 2) of each element below another one; parts that are not drawn are left out."""
    left = [(root, outer)]
    while left:
        element, above = left.pop()
        inner = above @ _matrix(element.get("transform", ""))
        name = element.tag.rpartition("}")[2]
        if name in ("defs", "clipPath", "symbol", "mask", "text"):
            continue
        for points, is_closed in _SHAPES[name](element) if name in _SHAPES else ():
            placed = [(inner @ [*point, 1.0])[:2] for point in points]
            yield [np.array(segment) for segment in _join(placed, is_closed)]
        left += [(child, inner) for child in element]


def _matrix(text: str) -> FloatArray:
    matrix = np.eye(3)
    for name, given in _CHANGE.findall(text):
        values = _numbers(given)
        step = np.eye(3)
        if name == "matrix":
            step[:2] = np.reshape(values, (3, 2)).T
        elif name == "translate":
            step[:2, 2] = values[0], (values[1:] or [0.0])[0]
        elif name == "scale":
            step[0, 0], step[1, 1] = values[0], values[-1]
        else:
            angle, x, y = (*values, 0.0, 0.0)[:3]
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            step[:2] = [[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y]]
        matrix = matrix @ step
    return matrix


def _of_path(element: ElementTree.Element) -> Iterator[tuple[list[Any], bool]]:
    """Yield the runs of points of a path, and whether each is closed."""
    points: list[Any] = []
    for command, given in _PATH.findall(element.get("d", "")):
        kind, values = command.upper(), _numbers(given)
        if kind == "Z":
            yield points, True
            points = points[:1]
            continue
        taken = _TAKEN[kind]
        for k in range(0, len(values) - taken + 1, taken):
            x, y = points[-1] if points else (0.0, 0.0)
            relative = (x, y) if command.islower() else (0.0, 0.0)
            last = values[k : k + taken]
            place = {"H": (last[-1] + relative[0], y), "V": (x, last[-1] + relative[1])}.get(kind)
            place = place or (last[-2] + relative[0], last[-1] + relative[1])
            if kind == "M" and k == 0:
                yield points, False
                points = []
            points.append(place)
    yield points, False


def _pairs(text: str) -> list[tuple[float, float]]:
    values = _numbers(text)
    return list(zip(values[::2], values[1::2], strict=False))


def _of_rectangle(element: ElementTree.Element) -> list[tuple[list[Any], bool]]:
    x, y, width, height = (float((_numbers(element.get(key, "0")) or [0])[0]) for key in ("x", "y", "width", "height"))
    return [([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], True)]


_SHAPES: dict[str, Callable[[ElementTree.Element], Any]] = {
    "line": lambda e: [(_pairs(" ".join(e.get(key, "0") for key in ("x1", "y1", "x2", "y2"))), False)],
    "polyline": lambda e: [(_pairs(e.get("points", "")), False)],
    "polygon": lambda e: [(_pairs(e.get("points", "")), True)],
    "rect": _of_rectangle,
    "path": _of_path,
}
_DRAWN = "LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE"
_READERS: dict[str, Callable[[Path], DrawnPlan]] = {".dxf": _read_dxf, ".svg": _read_svg}
SUFFIXES = (*_READERS, ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")
