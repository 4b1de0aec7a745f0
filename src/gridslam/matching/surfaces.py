"""Surfaces that scans see: points with normals, which are matched scan to scan without a map."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from gridslam.grid.scan_batch import ScanBatch
from gridslam.kernels import backend
from gridslam.kernels.reference_surfaces import project_on_determined
from gridslam.types import FloatArray, IntArray

LEAST_INFORMATION = 0.02
"""Of the position along a direction, for each point: less is left open, as the noise of the normals would determine it
along a corridor, where nearest points seem to stand still. It is the mean square of the normals' share."""


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
    squares : (P,) float64, m^2
        Sums of their squared residuals.
    """

    information: FloatArray
    gradients: FloatArray
    counts: IntArray
    squares: FloatArray


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
    def of(cls, batch: ScanBatch, reach_m: float = 0.0, threads: int = 1) -> Surfaces:
        """Fit lines to the ends of beams within `reach_m` of each other; of five neighbouring ones each if it is 0."""
        points, normals, bearings, starts = backend.fit_surfaces(*batch, reach_m, threads)
        return cls(points, normals, bearings, starts, batch.origins)

    def append(self, later: Surfaces) -> Surfaces:
        """Put the surfaces of other scans behind these."""
        return Surfaces(
            np.concatenate([self.points, later.points]),
            np.concatenate([self.normals, later.normals]),
            np.concatenate([self.bearings, later.bearings]),
            np.concatenate([self.starts, self.starts[-1] + later.starts[1:]]),
            np.concatenate([self.origins, later.origins]),
        )

    def of_scans(self, first: int, end: int | None = None) -> Surfaces:
        """Those of scans from `first` on, up to the one before `end`."""
        starts = self.starts[first : None if end is None else end + 1]
        own = slice(starts[0], starts[-1])
        return Surfaces(
            self.points[own], self.normals[own], self.bearings[own], starts - starts[0], self.origins[first:end]
        )

    def match(
        self,
        poses: FloatArray,
        pairs: IntArray,
        gate_m: float,
        scale_m: float,
        *,
        both: bool = True,
        by_incidence: bool = False,
        threads: int = 1,
    ) -> SurfaceMatches:
        """Match pairs (P, 2) of scans at poses (S, 3), point to line.

        Parameters
        ----------
        gate_m, scale_m : float, m
            Largest residual, and that at which a point weighs half.
        both : bool
            Whether points of the first are matched with lines of the second, too.
        by_incidence : bool
            Whether points that a beam grazes, which its noise moves along their line, weigh more.
        """
        sums = backend.match_surfaces(*self, poses, pairs, gate_m, scale_m, both, by_incidence, threads)
        information = sums[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        kept = project_on_determined(information, sums[:, 9], LEAST_INFORMATION)
        gradients = np.einsum("pij,pj->pi", kept, sums[:, 6:9])
        return SurfaceMatches(kept @ information @ kept, gradients, sums[:, 9].astype(np.int64), sums[:, 10])
