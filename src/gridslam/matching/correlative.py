"""Correlative search: tries every pose of a small window, for guesses too bad for a descent."""

from __future__ import annotations

import math
from typing import Annotated, final

import numpy as np

from gridslam.checked import checked
from gridslam.grid.tiles import TileMaps
from gridslam.matching.gauss_newton import GaussNewton, cauchy_weights
from gridslam.parameters import bounded, parameters
from gridslam.types import Beams, FloatArray, Match, Poses, Rows

__all__ = ["Correlative"]


@final
@checked
@parameters(frozen=True)
class Correlative:
    """Scores every pose of a window around each guess, then refines the best by Gauss-Newton.

    Parameters
    ----------
    window_m, window_rad : float
        Half the sides of the window.
    step_m, step_rad : float
        Spacing of the poses tried. The field attracts over half a metre, so 0.1 m and 0.05 rad reach every basin.
    beams : int
        Beams used in the search, spread evenly; the refinement uses all.
    refine : GaussNewton
        How the best pose is refined.

    References
    ----------
    Olson, Real-time correlative scan matching, ICRA 2009 (here without its multi-resolution pyramid: the
    windows are small).
    """

    window_m: float = bounded(0.5, ge=1e-6, le=1e6)
    window_rad: float = bounded(0.5, ge=1e-6, le=100)
    step_m: float = bounded(0.1, ge=1e-6, le=1e6)
    step_rad: float = bounded(0.05, ge=1e-6, le=100)
    beams: int = bounded(60, ge=8, le=100_000)
    refine: GaussNewton = GaussNewton()

    def __call__(
        self, maps: TileMaps, rows: Rows, guesses: Poses, priors: Annotated[FloatArray, "K", 3, 3], beams: Beams
    ) -> Match:
        """Match the scan to maps `rows` (K,) from `guesses` (K, 3) with prior information (K, 3, 3)."""
        ends = beams.ends[:: max(1, len(beams) // self.beams)]
        offsets = self._offsets()
        pairs = zip(rows, guesses, strict=True)
        starts = np.array([self._best(maps, row, guess, offsets, ends) for row, guess in pairs]).reshape(-1, 3)
        return self.refine(maps, rows, starts, priors, beams)

    def _offsets(self) -> FloatArray:
        """Offsets (M, 3) of the window, the nearest to the guess first, so that it wins a tie."""
        halves = math.ceil(self.window_m / self.step_m), math.ceil(self.window_rad / self.step_rad)
        across, turns = (np.arange(-half, half + 1) for half in halves)
        lattice = np.stack(np.meshgrid(across, across, turns, indexing="ij"), axis=-1).reshape(-1, 3)
        offsets: FloatArray = lattice.astype(np.float64) * np.array([self.step_m, self.step_m, self.step_rad])
        order = np.argsort(np.linalg.norm(offsets, axis=1), kind="stable")
        return np.take(offsets, order, axis=0)

    def _best(
        self, maps: TileMaps, row: np.int32, guess: FloatArray, offsets: FloatArray, ends: FloatArray
    ) -> FloatArray:
        tried = guess + offsets
        distances = maps.distances(np.full(len(tried), row, np.int32), tried, ends)
        agreement = cauchy_weights(distances, self.refine.cauchy_m).sum(axis=1)
        best: FloatArray = tried[int(agreement.argmax())]
        return best
