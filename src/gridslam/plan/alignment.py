"""Alignment of a map with another or with a plan, by their walls, without a first guess."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry import se2
from gridslam.plan.surfaces import SurfacePoints
from gridslam.plan.untyped import fft
from gridslam.types import FloatArray

_COARSE_M = 0.2
_HEADINGS = 8
"""Tried at most: at four of them a building's walls look alike."""
_REACHES_M = (0.6, 0.6, 0.4, 0.3, 0.2, 0.2, 0.15, 0.15, 0.15, 0.15)
_LAST_REACHES_M = _REACHES_M[-1:] * 15
_SCALED_REACHES_M = _REACHES_M[:1] * 6 + _REACHES_M + _LAST_REACHES_M  # a scale converges slowly
_ASIDE_M = 0.15
_CLOSE_M = 0.03
_AGREES_M = 0.1
_MOST_POINTS = 20_000


@final
class Alignment(NamedTuple):
    """A motion of one map onto another, and a scale.

    Attributes
    ----------
    pose : (3,) float64
        Pose of the moved map's frame in that of the other, m and rad.
    residual_m : float, m
        Root mean square distance of the surfaces that agree, across them.
    share : float
        Weight of the moved points within 10 cm of a surface of the other map, as a share of all.
    scale : float
        Length in the other map of 1 m of the moved one.
    """

    pose: FloatArray
    residual_m: float
    share: float
    scale: float = 1.0

    def transform(self, points: FloatArray) -> FloatArray:
        """Points (N, 2) of the moved map in the frame of the other."""
        return se2.transform_points(self.pose, self.scale * points)


def align_points(moved: SurfacePoints, fixed: SurfacePoints, is_drawn: bool = False) -> Alignment:
    """Align surfaces with fixed ones; `is_drawn`: the fixed ones are lines without a free side.

    The headings are those at which the histograms of the normals agree; at each the shift is the peak of the
    cross-correlation of the surfaces; each is refined by matching points to lines, and the one that most points agree
    with is taken.
    """
    few = _select_some(moved)
    headings = _find_headings(few, fixed, is_drawn)
    guesses = (np.array([*_find_shift(few, fixed, heading, is_drawn), heading]) for heading in headings)
    found = (_refine(Alignment(guess, np.inf, 0.0), few, fixed, is_drawn) for guess in guesses)
    return max(found, key=lambda alignment: alignment.share)


def align_walls(moved: SurfacePoints, fixed: SurfacePoints, guess: Alignment) -> Alignment:
    """Move and scale surfaces onto lines that were drawn, beginning with a guess that is right to half a metre.

    A map's walls may have come to lie on lines of their other faces: the refinement begins again a wall's thickness
    beside the place that it found, in eight directions, and the best result is taken.
    """
    few = _select_some(moved)
    found = _refine(guess, few, fixed, True, _SCALED_REACHES_M)
    angles = np.arange(8) * np.pi / 4
    asides = _ASIDE_M * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(8)])
    beside = [_refine(found._replace(pose=found.pose + aside), few, fixed, True, _LAST_REACHES_M) for aside in asides]
    return max(found, *beside, key=lambda alignment: _count_close(alignment, few, fixed))


def _count_close(found: Alignment, moved: SurfacePoints, fixed: SurfacePoints) -> float:
    """Weight of the moved points, each by its closeness to a line."""
    distances, _ = fixed.tree.query(found.transform(moved.positions))
    return float((moved.weights / (1 + (distances / _CLOSE_M) ** 2)).sum())


def _select_some(points: SurfacePoints) -> SurfacePoints:
    chosen = points.select(np.linspace(0, len(points) - 1, min(len(points), _MOST_POINTS)).astype(np.int64))
    return SurfacePoints(chosen.positions, chosen.normals, chosen.weights.clip(max=20.0))


def _find_headings(moved: SurfacePoints, fixed: SurfacePoints, is_drawn: bool) -> FloatArray:
    """Headings (K,), rad, at which most normals of both agree, the best first."""
    spectra = []
    for points in (fixed, moved):
        degrees = np.rad2deg(np.arctan2(points.normals[:, 1], points.normals[:, 0])) % 360
        histogram = np.bincount(degrees.astype(np.int64) % 360, points.weights.clip(max=20.0), 360)
        if is_drawn:
            histogram = histogram + np.roll(histogram, 180)
        spectra.append(fft.rfft(histogram + np.roll(histogram, 1) + np.roll(histogram, -1)))
    agreement = fft.irfft(spectra[0] * np.conj(spectra[1]), 360)
    peaks = np.flatnonzero((agreement >= np.roll(agreement, 1)) & (agreement > np.roll(agreement, -1)))
    return np.deg2rad(peaks[np.argsort(-agreement[peaks])][:_HEADINGS])


def _find_shift(moved: SurfacePoints, fixed: SurfacePoints, heading: float, is_drawn: bool) -> FloatArray:
    """Shift (2,), m, at which turned surfaces agree most with others, normals included; of lines at twice the angle."""
    pose = np.array([0.0, 0.0, heading])
    positions = se2.transform_points(pose, moved.positions)
    normals = se2.transform_points(pose, moved.normals)
    lows = positions.min(axis=0), fixed.positions.min(axis=0)
    sizes = [np.ptp(own, axis=0) / _COARSE_M + 3 for own in (positions, fixed.positions)]
    shape = [fft.next_fast_len(int(side)) for side in (sizes[0] + sizes[1])[::-1]]
    total = np.zeros(shape)
    for axis in (0, 1):
        spectra = []
        for own, low, across in ((positions, lows[0], normals), (fixed.positions, lows[1], fixed.normals)):
            column, row = ((own - low) / _COARSE_M).astype(np.int64).T
            image = np.zeros(shape)
            parts = (across[:, 0] ** 2 - across[:, 1] ** 2, 2 * across[:, 0] * across[:, 1]) if is_drawn else across.T
            np.add.at(image, (row, column), parts[axis])
            spectra.append(fft.rfft2(np.clip(image, -3, 3)))
        total += fft.irfft2(spectra[1] * np.conj(spectra[0]), shape)
    row, column = np.unravel_index(np.argmax(total), total.shape)
    steps = np.array([column, row], np.float64)
    sides = np.array(shape[::-1])
    wrapped = np.where(steps > sides - sizes[0], steps - sides, steps)
    return np.asarray(wrapped * _COARSE_M + lows[1] - lows[0])


def _refine(
    guess: Alignment,
    moved: SurfacePoints,
    fixed: SurfacePoints,
    is_drawn: bool,
    scaled_reaches_m: tuple[float, ...] = (),
) -> Alignment:
    """Match points to lines, with ever shorter reach, or with given ones and a scale; weighed by Cauchy's function."""
    found, is_scaled = guess, bool(scaled_reaches_m)
    residuals, agreeing = np.zeros(0), np.zeros(len(moved), np.bool_)
    for reach in scaled_reaches_m or _REACHES_M:
        positions = found.transform(moved.positions)
        normals = se2.transform_points([0.0, 0.0, found.pose[2]], moved.normals)
        distances, nearest = fixed.tree.query(positions, distance_upper_bound=reach)
        agreeing = np.isfinite(distances)
        facing = (normals[agreeing] * fixed.normals[nearest[agreeing]]).sum(axis=1)
        agreeing[agreeing] &= (np.abs(facing) if is_drawn else facing) > 0.9
        if agreeing.sum() < 10:
            return found._replace(residual_m=float("inf"), share=0.0)
        here, across = positions[agreeing], fixed.normals[nearest[agreeing]]
        residuals = ((fixed.positions[nearest[agreeing]] - here) * across).sum(axis=1)
        about = here.mean(axis=0)
        arms = here - about
        rows = np.column_stack(
            [across, arms[:, 0] * across[:, 1] - arms[:, 1] * across[:, 0], (arms * across).sum(axis=1)]
        )
        rows = rows[:, : 4 if is_scaled else 3]
        weights = moved.weights[agreeing] / (1 + (residuals / _CLOSE_M) ** 2)
        step, *_ = np.linalg.lstsq(rows.T @ (rows * weights[:, None]), rows.T @ (weights * residuals), rcond=None)
        growth = 1.0 + float(step[3]) if is_scaled else 1.0
        middle = growth * se2.transform_points([0.0, 0.0, step[2]], found.pose[:2] - about) + about + step[:2]
        heading = math.remainder(found.pose[2] + step[2], math.tau)
        found = found._replace(pose=np.array([*middle, heading]), scale=found.scale * growth)
    near = np.abs(residuals) < _AGREES_M
    share = moved.weights[agreeing][near].sum() / moved.weights.sum()
    return found._replace(residual_m=float(np.sqrt(np.mean(residuals[near] ** 2))), share=float(share))
