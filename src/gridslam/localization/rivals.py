"""Alternative pose hypotheses that the scans have not refuted."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.localization.belief import NEAR_M, NEAR_RAD, Estimate, bins, is_near
from gridslam.localization.known_map import PoseWeigher
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray

__all__ = ["NO_RIVALS", "RivalPlaces", "Rivals"]


class Rivals(NamedTuple):
    """Poses (K, 3) in the map, and the log-odds (K,) of each relative to the reported one."""

    poses: FloatArray
    log_odds: FloatArray

    @property
    def odds(self) -> float:
        """Odds of all of them together."""
        return float(np.exp(self.log_odds).sum())

    def spread_about(self, pose: FloatArray) -> FloatArray:
        """Mean square (3, 3) of how far they are from a pose (3,), each by its odds and as wide as half a cluster."""
        away, shares = self.poses - pose, np.exp(self.log_odds) / max(self.odds, 1e-300)
        away[:, 2] = wrap(away[:, 2])
        return np.asarray((shares * away.T) @ away + np.diag([NEAR_M / 2, NEAR_M / 2, NEAR_RAD / 2]) ** 2)


NO_RIVALS = Rivals(np.empty((0, 3)), np.empty(0))

_REFUTED = 6.0  # nats against a hypothesis; evidence for it is limited to half of that, as the map may be wrong


@final
@parameters(frozen=True, config=STRICT)
class RivalPlaces:
    """Tracks pose hypotheses that the particles no longer cover, until the scans refute them.

    In a building of equal rooms, or one that looks the same after half a turn, the particles end up in one of the
    places that look alike, by chance and by the small errors of the map, which are the same in scan after scan. So each
    cluster of the particles is stored as one pose: moved by odometry, refined where its surroundings fit best, and
    compared with the reported place. Only the evidence of a scan beyond the errors of the map counts for or against it.

    Parameters
    ----------
    most : int, >= 0
        So many are followed, those of the greatest weight; 0: none.
    least_mass : float, (0, 1]
        A cluster of less weight is not a hypothesis.
    margin : float, [0, 1]
        By so much the shares of agreeing beams differ in places that are alike: the map is rounded to cells.
    nats : float, >= 0
        Evidence of a scan if no beam agrees with one place and all do with the other: 120 beams, of whose evidence
        `LikelihoodField` uses a fraction of 0.05.
    tries : int, >= 1
        Poses looked at about each.
    jitter_m, jitter_rad : float, m and rad, >= 0
        How far about it: what odometry may be wrong by between two updates.

    Source: after A. Milstein, J. Sanchez and E. Williamson, Robust global localization using clustered particle
    filtering (AAAI 2002), which keeps a filter for each cluster.
    """

    most: int = Field(default=32, ge=0)
    least_mass: float = Field(default=0.005, gt=0, le=1)
    margin: float = Field(default=0.05, ge=0, le=1)
    nats: float = Field(default=6.0, ge=0)
    tries: int = Field(default=64, ge=1)
    jitter_m: float = Field(default=0.05, ge=0)
    jitter_rad: float = Field(default=0.03, ge=0)

    def __call__(
        self, rivals: Rivals, moved: FloatArray, told: Estimate, poses: FloatArray, weights: FloatArray,
        agree: PoseWeigher, rng: np.random.Generator,
    ) -> Rivals:  # fmt: skip
        """Propagate hypotheses by a motion `moved` (3,), update them with the scan of `agree`, and add new ones.

        Parameters
        ----------
        told : Estimate
            The reported place.
        poses, weights : (N, 3), (N,) float64
            The particles, which may contain new hypotheses; weights sum to 1.
        """
        new = self._clusters(poses, weights) if told.mass < 1 - self.least_mass else np.empty((0, 3))
        places = np.concatenate([compose(rivals.poses, moved), new])
        places, odds = self._merged(places, np.append(rivals.log_odds, np.zeros(len(new))), told.pose)
        if not len(places):
            return NO_RIVALS
        places, agreement = self._held(np.concatenate([told.pose[None], places]), agree, rng)
        better = agreement[1:] - agreement[0]
        told_apart = np.sign(better) * np.maximum(np.abs(better) - self.margin, 0)
        odds = np.clip(odds + self.nats * told_apart, -_REFUTED, _REFUTED / 2)
        kept = np.flatnonzero(odds > -_REFUTED)
        return Rivals(places[1:][kept], odds[kept])

    def _merged(self, places: FloatArray, log_odds: FloatArray, told: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Merge nearby hypotheses, drop those near the estimate, and limit their number."""
        kept = list[int]()
        for k in range(len(places)):
            others = np.concatenate([told[None], places[kept]])
            if len(kept) < self.most and not is_near(others, places[k]).any():
                kept.append(k)
        return places[kept], log_odds[kept]

    def _clusters(self, poses: FloatArray, weights: FloatArray) -> FloatArray:
        """Heaviest particle (K, 3) of each cluster of enough weight, the heaviest cluster first."""
        names = bins(*poses.T.copy())
        mass = np.bincount(names, weights)
        heavy = np.flatnonzero(mass >= self.least_mass)
        heavy = heavy[np.argsort(-mass[heavy], kind="stable")][: self.most + 1]  # one is the reported one
        return np.array([poses[(weights * (names == one)).argmax()] for one in heavy]).reshape(-1, 3)

    def _held(self, places: FloatArray, agree: PoseWeigher, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """The pose about each of places (K, 3) where most beams agree, and their share (K,)."""
        noise = rng.standard_normal((len(places), self.tries, 3)) * [self.jitter_m, self.jitter_m, self.jitter_rad]
        noise[:, 0] = 0
        tried = places[:, None] + noise
        tried[..., 2] = wrap(tried[..., 2])
        shares = agree(tried.reshape(-1, 3)).reshape(len(places), self.tries)
        best = shares.argmax(axis=1)[:, None]
        return np.take_along_axis(tried, best[..., None], 1)[:, 0], np.take_along_axis(shares, best, 1)[:, 0]
