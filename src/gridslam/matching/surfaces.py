"""Surfaces that scans see: points with normals, which are matched scan to scan without a map."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.scan_batch import ScanBatch
from gridslam.kernels import backend
from gridslam.kernels.reference_surfaces import rank_bearings
from gridslam.types import FloatArray, IntArray

__all__ = ["SurfaceMatches", "Surfaces"]

_BESIDE = 2
"""Neighbours on either side of a point with which a line is fitted."""
_LONGEST_GAP_M = 0.4
_LONGEST_GAP_RATIO = 0.05
"""Neighbours on one surface are no farther apart, by metres, and by metres for each metre of range."""
_MOST_SPREAD_M = 0.06
"""Root of the summed squares of distances from the line, at most: corners have no normal."""
_REACH_M = 30.0
_LEAST_INFORMATION = 0.02
"""Of the position along a direction, for each point: less is left open. It is the mean square of the normals' share."""


@final
class SurfaceMatches(NamedTuple):
    """How the surfaces of pairs of scans fit, by the error of the pose of the second seen from the first.

    Attributes
    ----------
    information : (P, 3, 3) float64
        Weighted sums of outer products of the residuals' slopes, of beams with a standard deviation of 1 m.
    gradients : (P, 3) float64
        Weighted sums of residuals times slopes.
    counts : (P,) int64
        Points that were matched.
    """

    information: FloatArray
    gradients: FloatArray
    counts: IntArray


@final
class Surfaces(NamedTuple):
    """Points with normals that S scans see, B in all, each where neighbouring beams end on a line.

    Attributes
    ----------
    points, normals : (B, 2) float64
        Base frame; normals point to the laser.
    bearings : (B,) float64
        Ranks of the bearings from the laser (see `gridslam.kernels.reference_surfaces`), ascending within a scan.
    starts : (S + 1,) int64
        Scan s has points starts[s] to starts[s + 1] - 1.
    origins : (S, 2) float64, m
        Where the lasers are.
    """

    points: FloatArray
    normals: FloatArray
    bearings: FloatArray
    starts: IntArray
    origins: FloatArray

    @classmethod
    def of(cls, batch: ScanBatch) -> Surfaces:
        """Fit lines to the ends of five neighbouring beams each."""
        if not len(batch.ends):
            return cls(batch.ends, batch.ends, np.empty(0), np.zeros(batch.size + 1, np.int64), batch.origins)
        scans = np.repeat(np.arange(batch.size), np.diff(batch.starts))
        ways = batch.ends - batch.origins[scans]
        bearings = rank_bearings(ways)
        if (np.diff(bearings) < 0)[np.diff(scans) == 0].any():
            order = np.lexsort((bearings, scans))
            ways, bearings = ways[order], bearings[order]
        x, y = ways.T
        squares = np.square(ways).sum(axis=1)
        gaps = np.append(np.hypot(np.diff(x), np.diff(y)), np.inf)
        is_near = gaps < _LONGEST_GAP_M + _LONGEST_GAP_RATIO * np.sqrt(squares)
        is_near[batch.starts[1:] - 1] = False
        is_line = (squares < _REACH_M**2) & _all_about(is_near)
        count = 2 * _BESIDE + 1
        mx, my = _sum_about(x) / count, _sum_about(y) / count
        xx = _sum_about(x * x) - count * mx * mx
        yy = _sum_about(y * y) - count * my * my
        xy = _sum_about(x * y) - count * mx * my
        is_line &= 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy) < _MOST_SPREAD_M**2
        along = 0.5 * np.arctan2(2 * xy, xx - yy)[is_line]
        ways = ways[is_line]
        normals = np.column_stack([-np.sin(along), np.cos(along)])
        normals[(normals * ways).sum(axis=1) > 0] *= -1
        own = scans[is_line]
        starts = np.zeros(batch.size + 1, np.int64)
        np.cumsum(np.bincount(own, minlength=batch.size), out=starts[1:])
        return cls(ways + batch.origins[own], normals, bearings[is_line], starts, batch.origins)

    def append(self, later: Surfaces) -> Surfaces:
        """Put the surfaces of other scans behind these."""
        return Surfaces(
            np.concatenate([self.points, later.points]),
            np.concatenate([self.normals, later.normals]),
            np.concatenate([self.bearings, later.bearings]),
            np.concatenate([self.starts, self.starts[-1] + later.starts[1:]]),
            np.concatenate([self.origins, later.origins]),
        )

    def match(
        self, poses: FloatArray, pairs: IntArray, gate_m: float, scale_m: float, *, both: bool = True
    ) -> SurfaceMatches:
        """Match pairs (P, 2) of scans at poses (S, 3), point to line.

        Parameters
        ----------
        gate_m, scale_m : float, m
            Largest residual, and that at which a point weighs half.
        both : bool
            Whether points of the first are matched with lines of the second, too.
        """
        sums = backend.match_surfaces(*self, poses, pairs, gate_m, scale_m, both)
        information = sums[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        kept = _project_on_determined(information, sums[:, 9])
        gradients = np.einsum("pij,pj->pi", kept, sums[:, 6:9])
        return SurfaceMatches(kept @ information @ kept, gradients, sums[:, 9].astype(np.int64))


def _project_on_determined(information: FloatArray, counts: FloatArray) -> FloatArray:
    """Projections (P, 3, 3) that take out the directions of the position that surfaces leave open.

    Along a corridor the noise of the normals would determine the position, and nearest points seem to stand still.
    """
    least, across = np.linalg.eigh(information[:, :2, :2])
    is_open = least < _LEAST_INFORMATION * counts[:, None]
    projections = np.tile(np.eye(3), (len(information), 1, 1))
    projections[:, :2, :2] -= np.einsum("pik,pk,pjk->pij", across, is_open.astype(np.float64), across)
    return projections


def _sum_about(values: FloatArray) -> FloatArray:
    """Sum each of values (B,) and its neighbours on either side; zeros are beyond the ends."""
    padded = np.concatenate([np.zeros(_BESIDE), values, np.zeros(_BESIDE)])
    return np.asarray(sum(padded[k : k + len(values)] for k in range(2 * _BESIDE + 1)), np.float64)


def _all_about(is_near: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether all steps (B,) to the next point are short, from the second point before each to the second one after."""
    padded = np.concatenate([np.zeros(_BESIDE, np.bool_), is_near, np.zeros(_BESIDE, np.bool_)])
    return np.asarray(np.logical_and.reduce([padded[k : k + len(is_near)] for k in range(2 * _BESIDE)]), np.bool_)
