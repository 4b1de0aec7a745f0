"""How the particles move: the best one by the mean of the motion, the others by a draw or a search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.angles import wrap_headings
from gridslam.grid.tiles import TileMaps
from gridslam.types import FloatArray, MotionSampler, ScanLikelihood

_DRAWS = 200
"""Draws of a search: as many peaks of a match as half a metre and ten degrees hold."""

_WIDER = 2.0
"""So much wider than the motion is searched: where it was not measured for several scans its errors have added up."""

_LEAST_KNOWN = 0.75
"""Ratio of beams that end in known cells from which on a map decides; else new walls would be laid on old ones."""

_MOST_MATCHES = 4
"""More count as four: matches to the same surfaces have like errors."""

_FREEDOM = 4e5
"""Covariances of the motion are so much larger where matches are to follow the map: it holds next to nothing."""


@final
@dataclass(frozen=True, slots=True)
class SearchingMotion:
    """Motion that no match has measured: where its map knows the place, a particle takes the likeliest of many draws.

    The motion is less certain than the peak of a match is wide: from one draw a match would end beside it.
    """

    motion: MotionSampler
    maps: TileMaps
    likelihood: ScanLikelihood
    ends: FloatArray

    def __call__(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw successors (N, 3) of all particles (N, 3)."""
        found = self.motion(poses, rng)
        means, _ = self.motion.moments(poses)
        known = [self.maps.is_known(row, self.ends, mean).mean() for row, mean in enumerate(means)]
        searching = np.flatnonzero(np.array(known) >= _LEAST_KNOWN)
        if not len(searching):
            return found
        means = means[searching]
        away = wrap_headings(np.stack([self.motion(poses[searching], rng) for _ in range(_DRAWS)]) - means)
        drawn = means + _WIDER * away
        rows = np.tile(searching.astype(np.int32), _DRAWS)
        likelihoods = self.likelihood(self.maps, rows, drawn.reshape(-1, 3)).reshape(_DRAWS, -1)
        found[searching] = drawn[likelihoods.argmax(axis=0), np.arange(len(searching))]
        return found

    def moments(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean successors (N, 3) and their covariances (N, 3, 3), of one draw."""
        return self.motion.moments(poses)


@final
@dataclass(frozen=True, slots=True)
class MotionOfAll:
    """Motion of all particles: the best one takes the expected motion, the others are sampled.

    The best one, which is reported and mapped, is no sample: its draw is the mean, which holds its match. The others
    spread as their motion is drawn, and follow their maps: where a loop closes one of them fits better, and is the best
    from then on. An error that is common to all (variances in m^2 and rad^2) is left to the match. The motion of the
    best one was measured by matches of `scans` since the last key scan: its covariance is divided by the number of
    those before this one, which is matched to the particle's map, too; by 4 at most.
    """

    motion: MotionSampler
    best: int
    scans: int
    common_variances: tuple[float, float] | None

    def __call__(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw successors (N, 3) of all particles (N, 3)."""
        drawn = self.motion(poses, rng)
        drawn[self.best] = self.motion.moments(poses[self.best : self.best + 1])[0][0]
        return drawn

    def moments(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean successors (N, 3) and their covariances (N, 3, 3); of one pose those of the best particle."""
        means, covariances = self.motion.moments(poses)
        if self.common_variances is not None:
            covariances = covariances + np.diag(np.take(self.common_variances, [0, 0, 1]))
        if len(poses) == 1:
            return means, covariances
        freedom = np.full((len(poses), 1, 1), _FREEDOM)
        freedom[self.best] = 1.0 / min(max(self.scans - 1, 1), _MOST_MATCHES)
        return means, covariances * freedom
