"""Errors of maps: how far two occupancy grids agree, and landmarks against the true ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.evaluation.trajectory import align
from gridslam.geometry.se2 import transform_points
from gridslam.types import FloatArray, IntArray, OccupancyGrid

__all__ = [
    "LandmarkErrors",
    "MapAgreement",
    "align_points",
    "compare_maps",
    "landmark_errors",
    "pair_by_name",
    "pair_by_position",
]


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


@checked
def compare_maps(estimate: OccupancyGrid, reference: OccupancyGrid) -> MapAgreement:
    """Compare two grids of equal resolution in one frame; an offset of their origins is rounded to whole cells.

    Raises
    ------
    ArgumentError
        Resolutions differ, or no cell is known in both.
    """
    if not math.isclose(estimate.resolution_m, reference.resolution_m, rel_tol=1e-6):
        raise ArgumentError("estimate", f"the reference's resolution {reference.resolution_m} m", estimate.resolution_m)
    offset_m = np.subtract(estimate.origin, reference.origin)
    columns, rows = np.round(offset_m / reference.resolution_m).astype(int)
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
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of two grids that show the same cells, ours beginning at cell `offset` of theirs."""
    in_ours = list[slice]()
    in_theirs = list[slice]()
    for shift, our_cells, their_cells in zip(offset, ours, theirs, strict=True):
        begin = max(0, shift)
        end = max(begin, min(shift + our_cells, their_cells))
        in_ours.append(slice(begin - shift, end - shift))
        in_theirs.append(slice(begin, end))
    return tuple(in_ours), tuple(in_theirs)


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a = a - a.mean()
    b = b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0 else math.nan


@final
@dataclass(frozen=True, slots=True)
class LandmarkErrors:
    """How well landmarks were found.

    Attributes
    ----------
    found : int
        Landmarks of the truth that have a partner.
    missing : int
        Those that have none.
    surplus : int
        Landmarks in the map that have none: doubled, or of nothing.
    rmse_m, max_m : float, m
        Distances of partners after the map was moved to where it fits best.
    """

    found: int
    missing: int
    surplus: int
    rmse_m: float
    max_m: float


def pair_by_name(names: IntArray, true_names: IntArray) -> tuple[IntArray, IntArray]:
    """Return places (K,) in both of the names, each there once, that both have."""
    _, ours, theirs = np.intersect1d(names, true_names, assume_unique=True, return_indices=True)
    return ours, theirs


def pair_by_position(
    positions: FloatArray, truth: FloatArray, true_from_map: FloatArray, reach_m: float = 0.5
) -> tuple[IntArray, IntArray]:
    """Pair landmarks without comparable names by distance: the nearest first, each once.

    Parameters
    ----------
    positions, truth : (M, 2), (L, 2) float64, m
        Landmarks of the map and true ones.
    true_from_map : (3,) float64
        First guess of where the map lies; it is improved by the pairs as long as these change.
    reach_m : float, m
        Greatest distance of partners. Greater than what landmarks are apart is fine: the nearest pairs come first.

    Returns
    -------
    (K,) int64, (K,) int64
        Places of the partners.
    """
    pairs: list[list[int]] = []
    for _ in range(20):
        moved = transform_points(true_from_map, positions)
        distances = np.hypot(*(moved[:, None] - truth).transpose(2, 0, 1))
        before = pairs
        pairs = []
        while distances.size and distances.min() <= reach_m:
            i, j = np.unravel_index(distances.argmin(), distances.shape)
            pairs.append([int(i), int(j)])
            distances[i] = np.inf
            distances[:, j] = np.inf
        if pairs == before or len(pairs) < 2:
            break
        ours, theirs = np.array(pairs).T
        true_from_map = align(positions[ours], truth[theirs])
    ours, theirs = np.array(pairs, np.int64).reshape(-1, 2).T
    return ours, theirs


def align_points(positions: FloatArray, truth: FloatArray, reach_m: float = 0.5) -> FloatArray:
    """Return pose `true_from_map` (3,) that brings most landmarks (M, 2) near true ones (L, 2), without a first guess.

    Each pair of landmarks is brought onto each pair of true ones that is as far apart, within `reach_m`, and the
    landmarks are counted that then have a true one within it; of equal counts the nearest.

    References
    ----------
    M. Fischler, R. Bolles, Random sample consensus, CACM 1981 (here all samples instead of random ones).
    """
    best = np.zeros(3)
    greatest = 0.0
    if len(positions) < 2 or len(truth) < 2:
        return best
    ours = np.array([[i, j] for i in range(len(positions)) for j in range(i)])
    theirs = np.array([[k, n] for k in range(len(truth)) for n in range(len(truth)) if k != n])
    lengths = np.hypot(*(truth[theirs[:, 0]] - truth[theirs[:, 1]]).T)
    for i, j in ours.tolist():
        length = float(np.hypot(*(positions[i] - positions[j])))
        if length <= reach_m:
            continue  # too short for a heading
        for k, n in theirs[np.abs(lengths - length) <= reach_m].tolist():
            guess = align(positions[[i, j]], truth[[k, n]])
            moved = transform_points(guess, positions)
            nearest = np.hypot(*(moved[:, None] - truth).transpose(2, 0, 1)).min(axis=1)
            score = float(np.maximum(1.0 - nearest / reach_m, 0.0).sum())
            if score > greatest:
                best, greatest = guess, score
    return best


def landmark_errors(positions: FloatArray, truth: FloatArray, pairs: tuple[IntArray, IntArray]) -> LandmarkErrors:
    """Distances of landmarks (M, 2) from true ones (L, 2), by pairs, after alignment on SE(2).

    Raises ArgumentError where there is no pair.
    """
    ours, theirs = pairs
    if not len(ours):
        raise ArgumentError("pairs", "at least one", "none")
    moved = transform_points(align(positions[ours], truth[theirs]), positions[ours])
    errors = np.hypot(*(moved - truth[theirs]).T)
    rmse = float(np.sqrt(np.mean(np.square(errors))))
    missing = len(truth) - len(ours)
    return LandmarkErrors(len(ours), missing, len(positions) - len(ours), rmse, float(errors.max()))
