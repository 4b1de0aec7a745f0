"""Points on surfaces with their normals, from the end points of scans or from the cells of a grid."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.plan.untyped import connected_components, coo_matrix, spatial
from gridslam.types import FloatArray, IntArray, OccupancyGrid

_NEAR_M = 0.25
"""Neighbours within this distance determine a normal: two cells in each direction are five, enough for a line."""
_MOST_PENDING = 200_000
_MOST_PAIRS = 1_000_000
_LINK_M = 0.3
_LINK_RAD = np.deg2rad(25)
_LINK_OFFSET_M = 0.08
_SIDES = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])


@final
@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points at which beams ended, each on one side of a surface.

    Attributes
    ----------
    positions : (N, 2) float64, m
    normals : (N, 2) float64
        Unit vectors that point to where the surface was seen from, into free space.
    weights : (N,) float64, > 0
        How many beams, or how much of a cell, a point stands for.
    """

    positions: FloatArray
    normals: FloatArray
    weights: FloatArray

    @cached_property
    def tree(self) -> Any:  # noqa: ANN401
        """Return a k-d tree of the positions."""
        return spatial.cKDTree(self.positions)

    def select(self, chosen: NDArray[np.bool_] | IntArray | slice) -> SurfacePoints:
        """Those that are chosen, by a mask (N,), their numbers or a slice."""
        return SurfacePoints(*(values[chosen] for values in self))

    def __iter__(self) -> Iterator[FloatArray]:
        """Yield positions, normals and weights."""
        return iter((self.positions, self.normals, self.weights))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.positions)


def points_of_scans(scans: Iterable[tuple[FloatArray, FloatArray]], cell_m: float) -> SurfacePoints:
    """Average end points in cells, apart by the side from which they were seen.

    Parameters
    ----------
    scans : iterable of (origin (2,), ends (B, 2)), m
        Where the laser was, and where its beams ended, in the map frame.
    cell_m : float, m
        Side of the cells.
    """
    sums = np.zeros((0, 5))
    pending: list[FloatArray] = []
    for origin, ends in scans:
        views = origin - ends
        views /= np.maximum(np.hypot(*views.T), 1e-9)[:, None]
        pending.append(np.concatenate([ends, views, np.ones((len(ends), 1))], axis=1))
        if sum(map(len, pending)) > _MOST_PENDING:
            sums = _add_in_cells([sums, *pending], cell_m)
            pending = []
    sums = _add_in_cells([sums, *pending], cell_m)
    counts = sums[:, 4]
    return _orient(sums[:, :2] / counts[:, None], sums[:, 2:4], counts)


def _add_in_cells(parts: list[FloatArray], cell_m: float) -> FloatArray:
    """Sums (C, 5) of rows (N, 5), position, view and count, in cells: of each of the sides seen from four quarters."""
    rows = np.concatenate(parts)
    column, row = np.floor(rows[:, :2] / rows[:, 4:] / cell_m).astype(np.int64).T
    keys = (column << 33) + (row << 2) + (rows[:, 2] > 0) + 2 * (rows[:, 3] > 0)
    found, places = np.unique(keys, return_inverse=True)
    return np.asarray(np.column_stack([np.bincount(places, own, len(found)) for own in rows.T]), np.float64)


def points_of_grid(grid: OccupancyGrid) -> SurfacePoints:
    """Take each occupied cell beside a free one as a point of a surface, once for each side at which one is free."""
    occupied = grid.known & (grid.log_odds > 0)
    free = np.pad(grid.known & (grid.log_odds < 0), 1)
    rows, columns = np.nonzero(occupied)
    positions, views = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for side in _SIDES:
        beside = free[rows + 1 + side[1], columns + 1 + side[0]]
        cells = np.column_stack([columns, rows])[beside]
        positions.append(np.asarray(np.array(grid.origin) + (cells + 0.5) * grid.resolution_m, np.float64))
        views.append(np.broadcast_to(side, cells.shape))
    where = np.concatenate(positions)
    return _orient(where, np.concatenate(views).astype(np.float64), np.ones(len(where)))


def _orient(positions: FloatArray, views: FloatArray, weights: FloatArray) -> SurfacePoints:
    """Give points normals: across the direction in which their neighbours lie, to the side of the views.

    The second pass leaves out neighbours on the other side of a thin wall.
    """
    if len(positions) < 2:
        return SurfacePoints(positions[:0], views[:0], weights[:0])
    pairs = spatial.cKDTree(positions).query_pairs(_NEAR_M, output_type="ndarray")
    normals = _find_normals(positions, views, weights, _bands(pairs))
    facing = (band[np.einsum("ij,ij->i", normals[band[:, 0]], normals[band[:, 1]]) > 0.5] for band in _bands(pairs))
    return SurfacePoints(positions, _find_normals(positions, views, weights, facing), weights)


def _bands(pairs: IntArray) -> Iterator[IntArray]:
    """Some of the pairs (P, 2) at a time: the arrays of all would be large."""
    return (pairs[first : first + _MOST_PAIRS] for first in range(0, len(pairs), _MOST_PAIRS))


def _find_normals(
    positions: FloatArray, views: FloatArray, weights: FloatArray, bands: Iterable[IntArray]
) -> FloatArray:
    """Normals (N, 2) by the principal axes of each point's neighbourhood."""
    moments = np.zeros((3, len(positions)))
    for band in bands:
        apart = positions[band[:, 1]] - positions[band[:, 0]]
        for moment, (a, b) in zip(moments, ((0, 0), (0, 1), (1, 1)), strict=True):
            product = apart[:, a] * apart[:, b]
            for end in (0, 1):
                moment += np.bincount(band[:, end], product * weights[band[:, 1 - end]], len(positions))
    xx, xy, yy = moments
    across = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
    normals = np.column_stack([np.cos(across), np.sin(across)])
    flipped = np.einsum("ij,ij->i", normals, views) < 0
    normals[flipped] *= -1
    return normals


def label_surfaces(points: SurfacePoints) -> IntArray:
    """Number (N,) of the smooth surface that each point is on: neighbours lie in the line of both, and face one way."""
    pairs = points.tree.query_pairs(_LINK_M, output_type="ndarray")
    linked = [np.zeros((0, 2), np.int64)]
    for band in _bands(pairs):
        first, second = band.T
        apart = points.positions[second] - points.positions[first]
        smooth = np.einsum("ij,ij->i", points.normals[first], points.normals[second]) > np.cos(_LINK_RAD)
        for end in (first, second):
            smooth &= np.abs(np.einsum("ij,ij->i", apart, points.normals[end])) < _LINK_OFFSET_M
        linked.append(band[smooth])
    first, second = np.concatenate(linked).T
    graph = coo_matrix((np.ones(len(first), np.bool_), (first, second)), (len(points),) * 2)
    labels: IntArray = connected_components(graph, directed=False)[1]
    return labels
