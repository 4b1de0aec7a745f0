"""Which landmarks of a map are one: sets of pairs that are jointly compatible with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from gridslam.slam.landmarks.graph_slam import LandmarkGraphSolution
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.slam.pose_graph.marginals import Marginals
from gridslam.types import FloatArray, IntArray

__all__ = ["MergeHypothesis", "MergeSearch"]

_SURVEY = 0.02**2  # m^2: two estimates of one landmark are not nearer than that, whatever their covariance
_SEEDS = 60  # first pairs that are tried, the nearest


class MergeHypothesis(NamedTuple):
    """Pairs of landmarks that are one.

    Attributes
    ----------
    log_odds : float, nats
        Log odds of all pairs against all landmarks being different.
    pairs : tuple of (int, int)
        Places in the map.
    """

    log_odds: float
    pairs: tuple[tuple[int, int], ...]


@final
@dataclass(frozen=True)
class MergeSearch:
    """Search for landmarks that were put into a map twice.

    A path that is wrong for a while doubles all landmarks of a place, and all copies are off by about the same. So
    pairs are judged together: each pair that is taken as one corrects the Gaussian of all landmarks, and with it the
    distances of the others. If two landmarks are different, they are as near by chance, at the mean density of
    landmarks.

    Parameters
    ----------
    gate : float
        Greatest squared Mahalanobis distance of a pair, given the pairs taken before.
    together : float, [0, 1)
        Greatest share of the observations of the rarer of two landmarks that come with one of the other: two copies
        are not observed at one time, but for wrong correspondences.
    margin : float, nats
        By which the best set must be more likely than none, and than any that pairs one of its landmarks with another.

    References
    ----------
    J. Neira, J. Tardos, Data association in stochastic mapping using the joint compatibility test, T-RA 2001.
    """

    gate: float = 16.0
    together: float = 0.1
    margin: float = 3.0

    def __call__(self, solution: LandmarkGraphSolution, correspondences: list[IntArray]) -> IntArray:
        """Names (M,) that the landmarks have after the merge; those of the map where none is certain.

        Parameters
        ----------
        solution : LandmarkGraphSolution
            With these correspondences.
        correspondences : list of (K,) int64
            Names of the landmarks that are observed at each step.
        """
        found = solution.landmarks
        names = found.names.copy()
        counts = _count_together(names, correspondences)
        seldom = counts <= self.together * np.minimum(np.diag(counts)[:, None], np.diag(counts))
        pairs = np.argwhere(np.triu(seldom, 1))
        if len(pairs):
            spread = np.ptp(found.positions, axis=0)
            log_area = math.log(max(float(spread.prod()) / len(names), 1e-6))
            x = found.positions.ravel()
            hypotheses = self.hypotheses(x, _joint_covariance(solution), pairs, log_area)
            for i, j in self._certain(hypotheses):
                names[j] = names[i]
        return names

    def hypotheses(self, x: FloatArray, P: FloatArray, pairs: IntArray, log_area: float) -> list[MergeHypothesis]:
        """Sets of compatible pairs, the most likely first.

        Parameters
        ----------
        x, P : (2 M,), (2 M, 2 M) float64
            Positions of the landmarks and their covariance, m and m^2.
        pairs : (C, 2) int64
            Which pairs may be one.
        log_area : float
            Log of the mean area of a landmark, m^2.
        """
        squared, _ = _distances(x, P, pairs)
        seeds = np.argsort(squared, kind="stable")[:_SEEDS]
        found = {self._grow(x, P, pairs, int(seed), log_area) for seed in seeds[squared[seeds] <= self.gate]}
        return sorted(found, reverse=True)

    def _grow(self, x: FloatArray, P: FloatArray, pairs: IntArray, first: int, log_area: float) -> MergeHypothesis:
        """From a first pair on, take the likeliest pair that is compatible with those before, while one is likely."""
        taken = list[tuple[int, int]]()
        log_odds = 0.0
        left = pairs
        chosen = first
        gains = self._log_odds(x, P, left, log_area)
        while taken == [] or gains[chosen] > 0:
            i, j = left[chosen].tolist()
            log_odds += float(gains[chosen])
            taken.append((i, j))
            x, P = _condition(x, P, i, j)
            left = left[~np.isin(left, [i, j]).any(axis=1)]
            if not len(left):
                break
            gains = self._log_odds(x, P, left, log_area)
            chosen = int(gains.argmax())
        return MergeHypothesis(log_odds, tuple(sorted(taken)))

    def _log_odds(self, x: FloatArray, P: FloatArray, pairs: IntArray, log_area: float) -> FloatArray:
        """Log N(m_i - m_j; 0, S) against one landmark on the mean area, of each pair; -inf beyond the gate."""
        squared, log_dets = _distances(x, P, pairs)
        log_odds = log_area - math.log(2 * math.pi) - (squared + log_dets) / 2
        return np.where(squared <= self.gate, log_odds, -math.inf)

    def _certain(self, hypotheses: list[MergeHypothesis]) -> tuple[tuple[int, int], ...]:
        """Pairs of the best hypothesis, none if another is nearly as likely that contradicts it."""
        if not hypotheses:
            return ()
        best = hypotheses[0]
        partner = dict(best.pairs) | {j: i for i, j in best.pairs}
        rivals = [
            other.log_odds
            for other in hypotheses[1:]
            if any(partner.get(i, j) != j or partner.get(j, i) != i for i, j in other.pairs)
        ]
        return best.pairs if best.log_odds - max([0.0, *rivals]) >= self.margin else ()


def _count_together(names: IntArray, correspondences: list[IntArray]) -> IntArray:
    """At how many steps (M, M) two landmarks are observed together; on the diagonal, at how many each is."""
    place = {name: k for k, name in enumerate(names.tolist())}
    counts = np.zeros((len(place), len(place)), np.int64)
    for of_step in correspondences:
        seen = [place[name] for name in of_step.tolist() if name in place]
        counts[np.ix_(seen, seen)] += 1
    return counts


def _joint_covariance(solution: LandmarkGraphSolution) -> FloatArray:
    """Covariance (2 M, 2 M) of all landmarks: what systematic errors add is taken as independent."""
    marginals = Marginals(solution.solution.weighted_graph)
    first = len(solution.poses) + 1
    count = len(solution.landmarks)
    joint = np.empty((count, 2, count, 2))
    for k in range(count):
        joint[:, :, k] = marginals.covariances_with(first + k)[first:, :2, :2]
        joint[k, :, k] = solution.landmarks.covariances[k]
    covariance = joint.reshape(2 * count, 2 * count)
    return np.asarray((covariance + covariance.T) / 2)


def _distances(x: FloatArray, P: FloatArray, pairs: IntArray) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (C,) of pairs, and log determinants of their covariances."""
    i, j = pairs.T
    count = len(x) // 2
    blocks = P.reshape(count, 2, count, 2)
    S = blocks[i, :, i] + blocks[j, :, j] - blocks[i, :, j] - blocks[j, :, i] + _SURVEY * np.eye(2)
    positions = x.reshape(-1, 2)
    return mahalanobis(positions[i] - positions[j], S)


def _condition(x: FloatArray, P: FloatArray, i: int, j: int) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of all landmarks given that two are one."""
    H = np.zeros((2, len(x)))
    H[:, 2 * i : 2 * i + 2] = np.eye(2)
    H[:, 2 * j : 2 * j + 2] = -np.eye(2)
    gain = np.linalg.solve(H @ P @ H.T + _SURVEY * np.eye(2), H @ P).T
    return x - gain @ (H @ x), P - gain @ (H @ P)
