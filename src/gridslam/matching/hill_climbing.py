"""Hill climbing: the matcher of GMapping, which tries small moves and keeps the best."""

from __future__ import annotations

from typing import Annotated, final

import numpy as np

from gridslam.checked import checked
from gridslam.geometry.se2 import compose
from gridslam.grid.tiles import TileMaps
from gridslam.matching.gauss_newton import EVALUATE_ONLY
from gridslam.parameters import bounded, parameters
from gridslam.types import BeamEnds, FloatArray, Match, Poses, Rows

_MOVES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)


@final
@checked
@parameters(frozen=True)
class HillClimbing:
    """Moves forth and back, sideways and around by a step; where none scores better, the step is halved.

    Parameters
    ----------
    step_m, step_rad : float
        First steps, GMapping's `lstep` and `astep`.
    halvings : int
        How often the step is halved before the search ends, GMapping's `iterations`.
    scale_m2 : float, m^2
        A beam whose end is d from an obstacle inside the window scores exp(-d^2 / scale); GMapping's `sigma`.
    kernel_m : float, m
        Radius of the window; a beam with no obstacle in it scores nothing.
    minimum_score : float
        A match that scores less is refused and the guess kept, GMapping's `minimumScore`.

    Notes
    -----
    The prior takes no part, as in GMapping, whose odometry reliability is 0 by default.

    References
    ----------
    G. Grisetti, C. Stachniss, W. Burgard, GMapping (OpenSLAM), `ScanMatcher::optimize`.
    """

    step_m: float = bounded(0.05, ge=1e-3, le=100)
    step_rad: float = bounded(0.05, ge=1e-3, le=10)
    halvings: int = bounded(5, ge=0, le=60)
    scale_m2: float = bounded(0.05, ge=1e-9, le=1e4)
    kernel_m: float = bounded(0.075, ge=1e-6, le=100)
    minimum_score: float = bounded(0.0, ge=0, le=1e6)

    def __call__(
        self, maps: TileMaps, rows: Rows, guesses: Poses, priors: Annotated[FloatArray, "K", 3, 3], beams: BeamEnds
    ) -> Match:
        """Match the scan to maps `rows` (K,) from `guesses` (K, 3); `priors` (K, 3, 3) are not used."""
        poses = guesses.copy()
        scores = self._score(maps, rows, guesses, beams)
        steps = np.full(len(rows), 1.0)
        while (active := np.flatnonzero(steps >= 0.5**self.halvings)).size:
            moves = _MOVES * np.array([self.step_m, self.step_m, self.step_rad])
            tried = compose(poses[active, None], moves * steps[active, None, None])
            found = self._score(maps, np.repeat(rows[active], len(_MOVES)), tried.reshape(-1, 3), beams)
            found = found.reshape(len(active), len(_MOVES))
            best = found.argmax(axis=1)
            better = found[np.arange(len(active)), best] > scores[active]
            moved = active[better]
            poses[moved] = tried[better, best[better]]
            scores[moved] = found[better, best[better]]
            steps[active[~better]] /= 2
        poses = np.where((scores >= self.minimum_score)[:, None], poses, guesses)
        return EVALUATE_ONLY(maps, rows, poses, priors, beams)

    def _score(self, maps: TileMaps, rows: Rows, poses: FloatArray, beams: BeamEnds) -> FloatArray:
        distances = maps.distances(rows, poses, beams.ends)
        scores = np.where(distances <= self.kernel_m, np.exp(np.square(distances) * np.float32(-1 / self.scale_m2)), 0)
        return np.asarray(scores.sum(axis=1, dtype=np.float64))
