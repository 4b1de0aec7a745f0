"""Changes between two maps of a building, removed and new objects, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from PIL import Image, ImageDraw

from gridslam.geometry import se2
from gridslam.plan.alignment import Alignment
from gridslam.plan.rasters import BoolArray
from gridslam.plan.untyped import ndimage, require_map_extra
from gridslam.types import FloatArray, OccupancyGrid
from gridslam.viz.canvas import FREE, OCCUPIED, UNKNOWN, Colour

_NEAR_M = 0.12
"""Obstacles within this distance of earlier ones are the same: walls are drawn two cells thick."""
_LEAST_CELLS = 4
_LEAST_OPEN = 0.4
"""Of the cells about one that must be free on the other day, lest a single beam makes a change."""
_JOIN_M = 0.5
"""Edges of one piece of furniture are no farther apart: not all of its sides are seen."""
_ONE_DAY: Colour = (244, 238, 214)
_COLOURS: dict[str, Colour] = {"gone": (214, 40, 40), "new": (0, 130, 90)}
_LONGEST_PX = 4000


@final
@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Something that has gone or is new.

    Attributes
    ----------
    kind : str
        "gone" or "new".
    cells : (N, 2) float64, m
        Middles of the cells that are occupied on one day and free on the other, in the frame of the first map.
    outline : (4, 2) float64, m
        The smallest rectangle about them, anticlockwise, in the frame of the first map.
    area_m2 : float
        Area of the rectangle; of a piece that was seen from one side, of that side alone.
    """

    kind: str
    cells: FloatArray
    outline: FloatArray
    area_m2: float


@final
@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two maps, in the frame of the first.

    Attributes
    ----------
    changes : tuple of Change
        The largest first.
    first, second : OccupancyGrid
        Both maps in the cells of the first.
    alignment : Alignment
        How the second lies on the first.
    """

    changes: tuple[Change, ...]
    first: OccupancyGrid
    second: OccupancyGrid
    alignment: Alignment

    @property
    def both_m2(self) -> float:
        """Area that both maps know."""
        return float((self.first.known & self.second.known).sum()) * self.first.resolution_m**2


def find_changes(first: OccupancyGrid, second: OccupancyGrid, alignment: Alignment) -> Changes:
    """Find obstacles of one map where the other one is free; cells that either has not seen are left open.

    A piece of furniture is seen as edges: those within half a metre are one's, and a rectangle is laid about them.
    """
    after = _resample(second, first, alignment.pose)
    found = [*_find_gone("gone", first, after), *_find_gone("new", after, first)]
    return Changes(tuple(sorted(found, key=lambda change: -change.area_m2)), first, after, alignment)


def _resample(grid: OccupancyGrid, onto: OccupancyGrid, pose: FloatArray) -> OccupancyGrid:
    """A map in the cells of another one, by the nearest cell; unknown beyond its own."""
    rows, columns = np.indices(onto.shape).reshape(2, -1)
    middles = np.array(onto.origin) + (np.column_stack([columns, rows]) + 0.5) * onto.resolution_m
    places = se2.transform_points(se2.inverse(pose), middles)
    column, row = np.floor((places - grid.origin) / grid.resolution_m).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < grid.shape[0]) & (column < grid.shape[1])
    log_odds, known = np.zeros(len(rows), np.float32), np.zeros(len(rows), np.bool_)
    log_odds[inside] = grid.log_odds[row[inside], column[inside]]
    known[inside] = grid.known[row[inside], column[inside]]
    return OccupancyGrid(log_odds.reshape(onto.shape), known.reshape(onto.shape), onto.resolution_m, onto.origin)


def _find_gone(kind: str, here: OccupancyGrid, there: OccupancyGrid) -> list[Change]:
    """Find cells that are occupied here and amid free ones there."""
    _, shapely = require_map_extra()
    cell_m = here.resolution_m
    free = there.known & (there.log_odds < 0)
    near = ndimage.binary_dilation(there.known & (there.log_odds > 0), _disc(int(np.ceil(_NEAR_M / cell_m))))
    is_open = ndimage.uniform_filter(free.astype(np.float32), 5) > _LEAST_OPEN
    edges = here.known & (here.log_odds > 0) & free & is_open & ~near
    labels, count = ndimage.label(ndimage.binary_dilation(edges, _disc(round(_JOIN_M / 2 / cell_m))))
    changes = []
    for number, part in zip(range(1, count + 1), ndimage.find_objects(labels), strict=True):
        own = edges[part] & (labels[part] == number)
        cells = np.argwhere(own) + np.array([part[0].start, part[1].start])
        if len(cells) >= _LEAST_CELLS:
            low = np.asarray(np.array(here.origin) + cells[:, ::-1] * cell_m, np.float64)
            boxes = shapely.union_all(shapely.box(*low.T, *(low + cell_m).T))
            rectangle = shapely.geometry.polygon.orient(shapely.oriented_envelope(boxes))
            outline = np.array(rectangle.exterior.coords)[:-1]
            changes.append(Change(kind, np.asarray(low + cell_m / 2), outline, float(rectangle.area)))
    return changes


def _disc(cells: int) -> BoolArray:
    return np.asarray(np.hypot(*np.mgrid[-cells : cells + 1, -cells : cells + 1]) <= cells + 0.5, np.bool_)


def describe_changes(changes: Changes) -> list[dict[str, Any]]:
    """Each change: kind, area, middle and outline, in the first map's frame."""
    return [
        {
            "kind": change.kind,
            "area_m2": round(change.area_m2, 3),
            "middle_m": np.round(change.outline.mean(axis=0), 3).tolist(),
            "outline_m": np.round(change.outline, 3).tolist(),
        }
        for change in changes.changes
    ]


def write_changes_png(path: Path, changes: Changes) -> None:
    """Paint both maps over one another: gone red, new green, with their outlines; cells seen by one alone yellow."""
    first, second = changes.first, changes.second
    pixels = np.full((*first.shape, 3), UNKNOWN, np.uint8)
    pixels[first.known ^ second.known] = _ONE_DAY
    pixels[first.known & second.known] = FREE
    pixels[(first.known & (first.log_odds > 0)) | (second.known & (second.log_odds > 0))] = OCCUPIED
    for change in changes.changes:
        column, row = ((change.cells - first.origin) / first.resolution_m).astype(np.int64).T
        pixels[row, column] = _COLOURS[change.kind]
    height, width = first.shape
    scale = max(1, min(4, _LONGEST_PX // max(height, width)))
    page = Image.fromarray(pixels[::-1]).resize((width * scale, height * scale), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(page)
    for change in changes.changes:
        x, y = (change.outline - first.origin).T / first.resolution_m * scale
        draw.polygon(
            [*zip(x.tolist(), (height * scale - y).tolist(), strict=True)], outline=_COLOURS[change.kind], width=2
        )
    page.save(path, compress_level=3)
