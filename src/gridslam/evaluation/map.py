"""How far two occupancy grids of one place agree."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.types import FloatArray, OccupancyGrid

__all__ = ["MapAgreement", "compare_maps"]


@final
@dataclass(frozen=True, slots=True)
class MapAgreement:
    """Comparison of an estimated with a reference map, over the cells that both know.

    Attributes
    ----------
    cells : int
        Cells known in both.
    coverage : float
        Their share of the cells that the reference knows.
    agreement : float
        Share of them that are occupied (log-odds above 0) in both or in neither.
    correlation : float
        Pearson's correlation of the occupancy probabilities; NaN where a map is the same everywhere.
    """

    cells: int
    coverage: float
    agreement: float
    correlation: float


def compare_maps(estimate: OccupancyGrid, reference: OccupancyGrid) -> MapAgreement:
    """Compare two grids of equal resolution in one frame; an offset of their origins is rounded to whole cells.

    Raises
    ------
    ArgumentError
        Resolutions differ, or no cell is known in both.
    """
    if not math.isclose(estimate.resolution_m, reference.resolution_m, rel_tol=1e-6):
        raise ArgumentError("estimate", f"the reference's resolution {reference.resolution_m} m", estimate.resolution_m)
    columns, rows = (
        round((ours - theirs) / reference.resolution_m)
        for ours, theirs in zip(estimate.origin, reference.origin, strict=True)
    )
    ours, theirs = _overlap(estimate.known.shape, reference.known.shape, (rows, columns))
    both = estimate.known[ours] & reference.known[theirs]
    cells = int(both.sum())
    if cells == 0:
        raise ArgumentError("estimate", "a cell known in both maps", "none")
    occupied = (estimate.log_odds[ours][both] > 0) == (reference.log_odds[theirs][both] > 0)
    a = estimate.probability[ours][both].astype(np.float64)
    b = reference.probability[theirs][both].astype(np.float64)
    return MapAgreement(cells, cells / int(reference.known.sum()), float(occupied.mean()), _correlation(a, b))


def _overlap(
    ours: tuple[int, ...], theirs: tuple[int, ...], offset: tuple[int, int]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of two grids that show the same cells, ours beginning at cell `offset` of theirs."""
    begin = [max(0, o) for o in offset]
    end = [max(b, min(o + mine, other)) for b, o, mine, other in zip(begin, offset, ours, theirs, strict=True)]
    in_ours = [slice(b - o, e - o) for b, e, o in zip(begin, end, offset, strict=True)]
    in_theirs = [slice(b, e) for b, e in zip(begin, end, strict=True)]
    return (in_ours[0], in_ours[1]), (in_theirs[0], in_theirs[1])


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0 else math.nan
