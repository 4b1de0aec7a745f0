"""Alternative pose hypotheses that the scans have not refuted."""

from __future__ import annotations

from typing import Annotated, NamedTuple, final

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.localization.belief import CLUSTER_RADIUS_M, CLUSTER_RADIUS_RAD, PoseEstimate, cluster_bins, is_in_cluster
from gridslam.localization.known_map import PoseLikelihood
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray

__all__ = ["NO_HYPOTHESES", "HypothesisTracker", "PoseHypotheses"]


class PoseHypotheses(NamedTuple):
    """Poses (K, 3) in the map, and the log-odds (K,) of each relative to the reported one."""

    poses: Annotated[FloatArray, "K", 3]
    log_odds: Annotated[FloatArray, "K"]

    @property
    def odds(self) -> float:
        """Odds of all of them together."""
        return float(np.exp(self.log_odds).sum())

    def spread_about(self, pose: FloatArray) -> FloatArray:
        """Mean square (3, 3) of how far they are from a pose (3,), each by its odds and as wide as half a cluster."""
        away, shares = self.poses - pose, np.exp(self.log_odds) / max(self.odds, 1e-300)
        away[:, 2] = wrap(away[:, 2])
        width = np.diag([CLUSTER_RADIUS_M / 2, CLUSTER_RADIUS_M / 2, CLUSTER_RADIUS_RAD / 2])
        return np.asarray((shares * away.T) @ away + width**2)


NO_HYPOTHESES = PoseHypotheses(np.empty((0, 3)), np.empty(0))

_REFUTED = 6.0  # nats against a hypothesis; evidence for it is limited to half of that, as the map may be wrong


@final
@parameters(frozen=True, config=STRICT)
class HypothesisTracker:
    """Tracks pose hypotheses that the particles no longer cover, until the scans refute them.

    In a building of equal rooms, or one that looks the same after half a turn, the particles end up in one of the
    places that look alike, by chance and by the small errors of the map, which are the same in scan after scan. So each
    cluster of the particles is stored as one pose: moved by odometry, refined where its surroundings fit best, and
    compared with the reported place. Only the evidence of a scan beyond the errors of the map counts for or against it.

    Parameters
    ----------
    max_hypotheses : int, >= 0
        So many are followed, those of the greatest weight; 0: none.
    min_mass : float, (0, 1]
        A cluster of less weight is not a hypothesis.
    margin : float, [0, 1]
        By so much the shares of agreeing beams differ in places that are alike: the map is rounded to cells.
    log_odds_per_scan : float, >= 0
        Evidence of a scan if no beam agrees with one place and all do with the other: 120 beams, of whose evidence
        `LikelihoodField` uses a fraction of 0.05.
    jitter_samples : int, >= 1
        Poses looked at about each.
    jitter_m, jitter_rad : float, m and rad, >= 0
        How far about it: what odometry may be wrong by between two updates.

    Source: after A. Milstein, J. Sanchez and E. Williamson, Robust global localization using clustered particle
    filtering (AAAI 2002), which keeps a filter for each cluster.
    """

    max_hypotheses: int = Field(default=32, ge=0)
    min_mass: float = Field(default=0.005, gt=0, le=1)
    margin: float = Field(default=0.05, ge=0, le=1)
    log_odds_per_scan: float = Field(default=6.0, ge=0)
    jitter_samples: int = Field(default=64, ge=1)
    jitter_m: float = Field(default=0.05, ge=0)
    jitter_rad: float = Field(default=0.03, ge=0)

    def __call__(
        self, hypotheses: PoseHypotheses, moved: FloatArray, estimate: PoseEstimate, poses: FloatArray,
        weights: FloatArray, agree: PoseLikelihood, rng: np.random.Generator,
    ) -> PoseHypotheses:  # fmt: skip
        """Propagate hypotheses by a motion `moved` (3,), update them with the scan of `agree`, and add new ones.

        Parameters
        ----------
        estimate : PoseEstimate
            The reported place.
        poses, weights : (N, 3), (N,) float64
            The particles, which may contain new hypotheses; weights sum to 1.
        """
        new = self._heaviest_of_clusters(poses, weights) if estimate.mass < 1 - self.min_mass else np.empty((0, 3))
        places = np.concatenate([compose(hypotheses.poses, moved), new])
        places, odds = self._merge(places, np.append(hypotheses.log_odds, np.zeros(len(new))), estimate.pose)
        if not len(places):
            return NO_HYPOTHESES
        places, agreement = self._refine_hypotheses(np.concatenate([estimate.pose[None], places]), agree, rng)
        better = agreement[1:] - agreement[0]
        evidence = np.sign(better) * np.maximum(np.abs(better) - self.margin, 0)
        odds = np.clip(odds + self.log_odds_per_scan * evidence, -_REFUTED, _REFUTED / 2)
        kept = np.flatnonzero(odds > -_REFUTED)
        return PoseHypotheses(places[1:][kept], odds[kept])

    def _merge(self, places: FloatArray, log_odds: FloatArray, estimate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Merge nearby hypotheses, drop those near the estimate, and limit their number."""
        kept = list[int]()
        for k in range(len(places)):
            others = np.concatenate([estimate[None], places[kept]])
            if len(kept) < self.max_hypotheses and not is_in_cluster(others, places[k]).any():
                kept.append(k)
        return places[kept], log_odds[kept]

    def _heaviest_of_clusters(self, poses: FloatArray, weights: FloatArray) -> FloatArray:
        """Heaviest particle (K, 3) of each cluster of enough weight, the heaviest cluster first."""
        names = cluster_bins(*poses.T.copy())
        mass = np.bincount(names, weights)
        heavy = np.flatnonzero(mass >= self.min_mass)
        heavy = heavy[np.argsort(-mass[heavy], kind="stable")][: self.max_hypotheses + 1]  # one is the reported one
        return np.array([poses[(weights * (names == one)).argmax()] for one in heavy]).reshape(-1, 3)

    def _refine_hypotheses(
        self, places: FloatArray, agree: PoseLikelihood, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """The pose about each of places (K, 3) where most beams agree, and their share (K,)."""
        noise = rng.standard_normal((len(places), self.jitter_samples, 3))
        noise *= [self.jitter_m, self.jitter_m, self.jitter_rad]
        noise[:, 0] = 0
        tried = places[:, None] + noise
        tried[..., 2] = wrap(tried[..., 2])
        shares = agree(tried.reshape(-1, 3)).reshape(len(places), self.jitter_samples)
        best = shares.argmax(axis=1)[:, None]
        return np.take_along_axis(tried, best[..., None], 1)[:, 0], np.take_along_axis(shares, best, 1)[:, 0]
