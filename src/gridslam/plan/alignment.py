"""How one map lies on another: the rigid motion by which most surfaces of both agree, without a first guess."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from gridslam.geometry import se2
from gridslam.plan.surfaces import SurfacePoints
from gridslam.plan.untyped import fft, spatial
from gridslam.types import FloatArray

__all__ = ["Alignment", "align_points"]

_COARSE_M = 0.2
_HEADINGS = 8
"""Tried at most: at four of them a building's walls look alike."""
_REACHES_M = (0.6, 0.6, 0.4, 0.3, 0.2, 0.2, 0.15, 0.15, 0.15, 0.15)
_AGREES_M = 0.1
_MOST_POINTS = 20_000


@final
class Alignment(NamedTuple):
    """A rigid motion of one map onto another.

    Attributes
    ----------
    pose : (3,) float64
        Pose of the moved map's frame in that of the other, m and rad.
    residual_m : float, m
        Root mean square distance of the surfaces that agree, across them.
    share : float
        Weight of the moved points within 10 cm of a surface of the other map, as a share of all.
    """

    pose: FloatArray
    residual_m: float
    share: float


def align_points(moved: SurfacePoints, fixed: SurfacePoints) -> Alignment:
    """Find how surfaces lie on others.

    The headings are those at which the histograms of the normals agree; at each the shift is the peak of the
    cross-correlation of the surfaces; each is refined by matching points to lines, and the one that most points agree
    with is taken.
    """
    chosen = np.linspace(0, len(moved) - 1, min(len(moved), _MOST_POINTS)).astype(np.int64)
    few = SurfacePoints(moved.positions[chosen], moved.normals[chosen], moved.weights[chosen].clip(max=20.0))
    found = [
        _refine(np.array([*_find_shift(few, fixed, heading), heading]), few, fixed)
        for heading in _find_headings(few, fixed)
    ]
    return max(found, key=lambda alignment: alignment.share)


def _find_headings(moved: SurfacePoints, fixed: SurfacePoints) -> FloatArray:
    """Headings (K,), rad, at which most normals of both agree, the best first."""
    spectra = []
    for points in (fixed, moved):
        degrees = np.rad2deg(np.arctan2(points.normals[:, 1], points.normals[:, 0])) % 360
        histogram = np.bincount(degrees.astype(np.int64) % 360, points.weights.clip(max=20.0), 360)
        spectra.append(fft.rfft(histogram + np.roll(histogram, 1) + np.roll(histogram, -1)))
    agreement = fft.irfft(spectra[0] * np.conj(spectra[1]), 360)
    peaks = np.flatnonzero((agreement >= np.roll(agreement, 1)) & (agreement > np.roll(agreement, -1)))
    return np.deg2rad(peaks[np.argsort(-agreement[peaks])][:_HEADINGS])


def _find_shift(moved: SurfacePoints, fixed: SurfacePoints, heading: float) -> FloatArray:
    """Shift (2,), m, at which turned surfaces agree most with others, normals included."""
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
            np.add.at(image, (row, column), across[:, axis])
            spectra.append(fft.rfft2(np.clip(image, -3, 3)))
        total += fft.irfft2(spectra[1] * np.conj(spectra[0]), shape)
    row, column = np.unravel_index(np.argmax(total), total.shape)
    steps = np.array([column, row], np.float64)
    sides = np.array(shape[::-1])
    wrapped = np.where(steps > sides - sizes[0], steps - sides, steps)
    return np.asarray(wrapped * _COARSE_M + lows[1] - lows[0])


def _refine(pose: FloatArray, moved: SurfacePoints, fixed: SurfacePoints) -> Alignment:
    """Match points to lines, with ever shorter reach; weighed by Cauchy's function."""
    tree = spatial.cKDTree(fixed.positions)
    residuals, agreeing = np.zeros(0), np.zeros(len(moved), np.bool_)
    for reach in _REACHES_M:
        positions = se2.transform_points(pose, moved.positions)
        normals = se2.transform_points([0.0, 0.0, pose[2]], moved.normals)
        distances, nearest = tree.query(positions, distance_upper_bound=reach)
        agreeing = np.isfinite(distances)
        agreeing[agreeing] &= (normals[agreeing] * fixed.normals[nearest[agreeing]]).sum(axis=1) > 0.9
        if agreeing.sum() < 10:
            return Alignment(pose, float("inf"), 0.0)
        here, across = positions[agreeing], fixed.normals[nearest[agreeing]]
        residuals = ((fixed.positions[nearest[agreeing]] - here) * across).sum(axis=1)
        about = here.mean(axis=0)
        arms = here - about
        rows = np.column_stack([across, arms[:, 0] * across[:, 1] - arms[:, 1] * across[:, 0]])
        weights = moved.weights[agreeing] / (1 + (residuals / 0.03) ** 2)
        step, *_ = np.linalg.lstsq(rows.T @ (rows * weights[:, None]), rows.T @ (weights * residuals), rcond=None)
        turn = se2.compose(np.array([*(about + step[:2]), step[2]]), np.array([*-about, 0.0]))
        pose = se2.compose(turn, pose)
    near = np.abs(residuals) < _AGREES_M
    share = moved.weights[agreeing][near].sum() / moved.weights.sum()
    return Alignment(pose, float(np.sqrt(np.mean(residuals[near] ** 2))), float(share))
