"""Changes between two maps of a building: removed and new objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry import se2
from gridslam.plan.alignment import Alignment
from gridslam.plan.rasters import BoolArray, Raster, make_raster
from gridslam.plan.untyped import ndimage
from gridslam.types import FloatArray, OccupancyGrid

_NEAR_M = 0.12
"""Obstacles within this distance of earlier ones are the same: walls are drawn two cells thick."""
_LEAST_CELLS = 4
_LEAST_OPEN = 0.4
"""Of the cells about one that must be free on the other day, lest a single beam makes a change."""
_JOIN_M = 0.5
"""Edges of one piece of furniture are no farther apart: not all of its sides are seen."""


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
        The rectangle about them, anticlockwise.
    """

    kind: str
    cells: FloatArray
    outline: FloatArray

    @property
    def area_m2(self) -> float:
        """Area of the rectangle; of a piece that was seen from one side, of that side alone."""
        sides = np.hypot(*(self.outline[1:3] - self.outline[:2]).T)
        return float(sides[0] * sides[1])


@final
@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two maps, in the frame of the first.

    Attributes
    ----------
    changes : tuple of Change
        The largest first.
    first, second : Raster
        Both maps in the cells of the first.
    alignment : Alignment
        How the second lies on the first.
    """

    changes: tuple[Change, ...]
    first: Raster
    second: Raster
    alignment: Alignment

    @property
    def both_m2(self) -> float:
        """Area that both maps know."""
        known = [raster.free | raster.occupied for raster in (self.first, self.second)]
        return float((known[0] & known[1]).sum()) * self.first.cell_m**2


def find_changes(first: OccupancyGrid, second: OccupancyGrid, alignment: Alignment) -> Changes:
    """Find obstacles of one map where the other one is free; cells that either has not seen are left open.

    A piece of furniture is seen as edges: those within half a metre are one's, and a rectangle is laid about them.
    """
    before = make_raster(first)
    after = _resample(make_raster(second), before, alignment.pose)
    found = [*_find_gone("gone", before, after), *_find_gone("new", after, before)]
    return Changes(tuple(sorted(found, key=lambda change: -change.area_m2)), before, after, alignment)


def _resample(raster: Raster, onto: Raster, pose: FloatArray) -> Raster:
    """A raster in the cells of another one, by the nearest cell; unknown beyond its own."""
    height, width = onto.free.shape
    cells = np.column_stack([grid.reshape(-1) for grid in np.indices((height, width))])
    places = se2.transform_points(se2.inverse(pose), onto.points(cells))
    column, row = np.floor((places - raster.origin) / raster.cell_m).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < raster.free.shape[0]) & (column < raster.free.shape[1])
    taken = []
    for own in (raster.free, raster.occupied, raster.furniture):
        values = np.zeros(height * width, np.bool_)
        values[inside] = own[row[inside], column[inside]]
        taken.append(values.reshape(height, width))
    return Raster(taken[0], taken[1], taken[2], onto.cell_m, onto.origin)


def _find_gone(kind: str, here: Raster, there: Raster) -> list[Change]:
    """Find cells that are occupied here and amid free ones there."""
    near = ndimage.binary_dilation(there.occupied, _disc(int(np.ceil(_NEAR_M / here.cell_m))))
    is_open = ndimage.uniform_filter(there.free.astype(np.float32), 5) > _LEAST_OPEN
    edges = here.occupied & there.free & is_open & ~near
    labels, _ = ndimage.label(ndimage.binary_dilation(edges, _disc(round(_JOIN_M / 2 / here.cell_m))))
    labels[~edges] = 0
    changes = []
    for number, part in enumerate(ndimage.find_objects(labels), start=1):
        if part is not None and (labels[part] == number).sum() >= _LEAST_CELLS:
            cells = np.argwhere(labels[part] == number) + np.array([part[0].start, part[1].start])
            changes.append(Change(kind, here.points(cells), _enclose(here.points(cells), here.cell_m)))
    return changes


def _enclose(places: FloatArray, cell_m: float) -> FloatArray:
    """Rectangle (4, 2) around cells at places (N, 2), turned so that most of them are along its sides."""
    best, most = np.zeros((4, 2)), -1.0
    for angle in np.deg2rad(np.arange(0.0, 90.0, 3.0)):
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        turned = places @ axes.T
        low, high = turned.min(axis=0), turned.max(axis=0)
        beside = (np.minimum(turned - low, high - turned).min(axis=1) < 0.8 * cell_m).mean()
        score = float(beside - 0.02 * np.prod(high - low + cell_m))
        if score > most:
            low, high = low - cell_m / 2, high + cell_m / 2
            corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
            best, most = corners @ axes, score
    return best


def _disc(cells: int) -> BoolArray:
    return np.asarray(np.hypot(*np.mgrid[-cells : cells + 1, -cells : cells + 1]) <= cells + 0.5, np.bool_)
