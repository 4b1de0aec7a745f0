"""Pose estimate from particles: the densest cluster, its probability mass, and the hypotheses beside it."""

from __future__ import annotations

import math
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import compose, lever_arm_jacobian
from gridslam.localization.known_map import PoseLikelihood
from gridslam.types import FloatArray, IntArray

CLUSTER_RADIUS_M = 1.0
"""Poses within this distance of the estimate belong to its cluster, if their headings do."""

CLUSTER_RADIUS_RAD = 0.5
"""Headings within this angle of the estimate's belong to its cluster."""

CLUSTER_COVARIANCE = np.diag([CLUSTER_RADIUS_M / 2, CLUSTER_RADIUS_M / 2, CLUSTER_RADIUS_RAD / 2]) ** 2
"""Covariance (3, 3) of a pose that is known to be in a cluster, as wide as half of it."""

_FEW = 10.0  # effective particles, below which their spread is that of chance
_MOST_BINS = 1 << 20
_SHIFTS = 3  # towards the mean of what is near; the first centre is off by less than half a bin


class PoseEstimate(NamedTuple):
    """Pose estimate from the particles.

    Attributes
    ----------
    pose : (3,) float64
        Mean of the densest cluster.
    covariance : (3, 3) float64
        About the pose: of the cluster where most particles are in it, of all particles otherwise.
    mass : float, [0, 1]
        Weight of the cluster: the belief's probability that the robot is within 1 m and 0.5 rad of the pose.
    """

    pose: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]
    mass: float


def estimate_pose(poses: FloatArray, weights: FloatArray) -> PoseEstimate:
    """Find the densest cluster of poses (N, 3) with weights (N,) that sum to 1: mean shift from the heaviest bin.

    The spread is widened so that its inverse, which judges errors, has no bias of few particles: the inverse of the
    covariance of n samples of a Gaussian in three dimensions is n / (n - 5) times too large on average.

    Source: K. Mardia, J. Kent and J. Bibby, Multivariate Analysis (1979), Section 3.4 (the inverse Wishart's mean).
    """
    places = poses.T.copy()
    names = cluster_bins(*places)
    near = names == np.bincount(names, weights).argmax()
    centre = poses[np.flatnonzero(near)[weights[near].argmax()]]
    away = _relative_coordinates(places, centre)
    for _ in range(_SHIFTS):
        before = near
        shares = np.where(near, weights, 0.0)
        centre = wrap_headings(centre + np.einsum("in,n->i", away, shares) / shares.sum())
        away = _relative_coordinates(places, centre)
        near = _is_in_cluster(away)
        if np.array_equal(near, before):  # the centre is their mean
            break
    mass = float(weights[near].sum())
    if mass > 0.5:
        away, weights = away[:, near], weights[near]
    effective = weights.sum() ** 2 / np.square(weights).sum()
    if effective < _FEW:  # too few do not determine the spread: all weights are equal
        weights = np.ones(len(weights))
        effective = max(float(len(weights)), _FEW)
    covariance = np.einsum("in,jn->ij", weights * away, away) / weights.sum()
    return PoseEstimate(centre, covariance * (effective / (effective - 5)), min(mass, 1.0))


def cluster_bins(x: FloatArray, y: FloatArray, theta: FloatArray) -> IntArray:
    """Return number (N,) of the bin that each pose is in; bins are as wide as a cluster, and numbered in order."""
    sides = (2 * CLUSTER_RADIUS_M, 2 * CLUSTER_RADIUS_M, 2 * CLUSTER_RADIUS_RAD)
    if all(np.ptp(values) < side for values, side in zip((x, y, theta), sides, strict=True)):
        return np.zeros(len(x), np.int64)
    column, row, turn = (
        np.floor((values - values.min()) * (1 / side)).astype(np.int64)
        for values, side in zip((x, y, theta), sides, strict=True)
    )
    if float(column.max()) * float(row.max()) >= _MOST_BINS:  # far apart: only places that hold some are numbered
        column, row = (np.unique(places, return_inverse=True)[1] for places in (column, row))
    names = np.asarray((column * (row.max() + 1) + row) * (turn.max() + 1) + turn)
    return names if names.max() < _MOST_BINS else np.unique(names, return_inverse=True)[1]


def is_in_cluster(poses: FloatArray, centre: FloatArray) -> NDArray[np.bool_]:
    """Return which of poses (N, 3) are as near to a centre (3,) as belongs to one cluster."""
    return _is_in_cluster(_relative_coordinates(poses.T, centre))


def _is_in_cluster(away: FloatArray) -> NDArray[np.bool_]:
    """Return which of coordinates (3, N), as seen from a centre, belong to its cluster."""
    return np.asarray((away[0] ** 2 + away[1] ** 2 < CLUSTER_RADIUS_M**2) & (np.abs(away[2]) < CLUSTER_RADIUS_RAD))


def _relative_coordinates(places: FloatArray, centre: FloatArray) -> FloatArray:
    """Return coordinates (3, N) of poses (3, N) from a centre (3,), along the map's axes."""
    away = places - centre[:, None]
    turn = away[2]  # of two angles in [-pi, pi): at most one turn too far
    turn[turn >= math.pi] -= math.tau
    turn[turn < -math.pi] += math.tau
    return np.asarray(away)


def propagate_covariance(covariance: FloatArray, way: FloatArray, noise: FloatArray) -> FloatArray:
    """Covariance (3, 3) after a way (2,) in the world frame whose own is `noise`: a doubtful heading bends it."""
    jacobian = lever_arm_jacobian(np.zeros(3), way)
    return np.asarray(jacobian @ covariance @ jacobian.T + noise)


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
        away = wrap_headings(self.poses - pose)
        shares = np.exp(self.log_odds) / max(self.odds, 1e-300)
        return np.asarray((shares * away.T) @ away + CLUSTER_COVARIANCE)


NO_HYPOTHESES = PoseHypotheses(np.empty((0, 3)), np.empty(0))

_CONVINCING = 1.0  # nats for a hypothesis, from which on particles are drawn there: less may be chance
_REFUTED = 6.0  # nats against a hypothesis; evidence for it is limited to half of that, as the map may be wrong


_MAX_HYPOTHESES = 32
"""So many are followed, those of the greatest weight."""

_MIN_MASS = 0.005
"""A cluster of less weight is not a hypothesis."""

_MARGIN = 0.05
"""By so much the shares of agreeing beams differ in places that are alike: the map is rounded to cells."""

_LOG_ODDS_PER_SCAN = 6.0
"""Evidence of a scan if no beam agrees with one place and all do with the other: 120 beams, of whose evidence
`LikelihoodField` uses a fraction of 0.05."""

_JITTER_SAMPLES = 64
"""Poses looked at about each hypothesis."""

JITTER: Final = 0.05, 0.05, 0.03
"""Standard deviations (m, m, rad) of these poses about it, as of the odometry between two updates."""


def update_hypotheses(
    hypotheses: PoseHypotheses,
    moved: FloatArray,
    estimate: PoseEstimate,
    poses: FloatArray,
    weights: FloatArray,
    agree: PoseLikelihood,
    rng: np.random.Generator,
) -> PoseHypotheses:
    """Propagate hypotheses by a motion `moved` (3,), update them with the scan of `agree`, and add new ones.

    Hypotheses are places that the particles no longer cover, and that scans have not refuted. In a building of equal
    rooms, or one that looks the same after half a turn, the particles end up in one of the places that look alike, by
    chance and by the small errors of the map, which are the same in scan after scan. So each cluster of the particles
    is stored as one pose: moved by odometry, refined where its surroundings fit best, and compared with the reported
    place. Only the evidence of a scan beyond the errors of the map counts for or against it.

    Parameters
    ----------
    estimate : PoseEstimate
        The reported place.
    poses, weights : (N, 3), (N,) float64
        The particles, which may contain new hypotheses; weights sum to 1.

    References
    ----------
    After A. Milstein, J. Sanchez and E. Williamson, Robust global localization using clustered particle
    filtering (AAAI 2002), which keeps a filter for each cluster.
    """
    new = _heaviest_of_clusters(poses, weights) if estimate.mass < 1 - _MIN_MASS else np.empty((0, 3))
    places = np.concatenate([compose(hypotheses.poses, moved), new])
    places, odds = _merge(places, np.append(hypotheses.log_odds, np.zeros(len(new))), estimate.pose)
    if not len(places):
        return NO_HYPOTHESES
    places, agreement = refine_places(np.concatenate([estimate.pose[None], places]), agree, rng)
    return without_refuted(places[1:], odds + compute_evidence(agreement[1:] - agreement[0]))


def compute_evidence(better: FloatArray) -> FloatArray:
    """Return log-odds (K,) by a scan of which the inlier ratio is `better` (K,) than at the reported place."""
    return np.asarray(_LOG_ODDS_PER_SCAN * np.sign(better) * np.maximum(np.abs(better) - _MARGIN, 0))


def without_refuted(places: FloatArray, log_odds: FloatArray) -> PoseHypotheses:
    """Return hypotheses at places (K, 3) with limited log-odds (K,), but for those that are refuted."""
    kept = log_odds > -_REFUTED
    return PoseHypotheses(places[kept], np.minimum(log_odds[kept], _REFUTED / 2))


def join_hypotheses(first: PoseHypotheses, second: PoseHypotheses, estimate: FloatArray) -> PoseHypotheses:
    """Return hypotheses of both, the more probable of two in one cluster, without those at the `estimate` (3,)."""
    log_odds = np.append(first.log_odds, second.log_odds)
    order = np.argsort(-log_odds, kind="stable")
    return PoseHypotheses(*_merge(np.concatenate([first.poses, second.poses])[order], log_odds[order], estimate))


def sample_hypotheses(
    hypotheses: PoseHypotheses, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Sample `count` poses (K, 3) about those hypotheses that are clearly more probable than the reported place.

    The sum of the weights, whose logarithms are (K,), is the probability of these hypotheses.
    """
    better = hypotheses.log_odds > _CONVINCING
    if not (better.any() and count):
        return np.empty((0, 3)), np.empty(0)
    odds = np.exp(hypotheses.log_odds[better])
    poses = hypotheses.poses[better][rng.choice(len(odds), size=count, p=odds / odds.sum())]
    poses = wrap_headings(poses + rng.normal(size=poses.shape) * JITTER)
    return poses, np.full(count, math.log(odds.sum() / (1 + odds.sum()) / count))


def _merge(places: FloatArray, log_odds: FloatArray, estimate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Merge nearby hypotheses, drop those near the estimate, and limit their number."""
    kept = list[int]()
    for k in range(len(places)):
        others = np.concatenate([estimate[None], places[kept]])
        if len(kept) < _MAX_HYPOTHESES and not is_in_cluster(others, places[k]).any():
            kept.append(k)
    return places[kept], log_odds[kept]


def _heaviest_of_clusters(poses: FloatArray, weights: FloatArray) -> FloatArray:
    """Heaviest particle (K, 3) of each cluster of enough weight, the heaviest cluster first."""
    names = cluster_bins(*poses.T.copy())
    mass = np.bincount(names, weights)
    heavy = np.flatnonzero(mass >= _MIN_MASS)
    heavy = heavy[np.argsort(-mass[heavy], kind="stable")][: _MAX_HYPOTHESES + 1]  # one is the reported one
    return np.array([poses[(weights * (names == one)).argmax()] for one in heavy]).reshape(-1, 3)


def refine_places(places: FloatArray, agree: PoseLikelihood, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return the pose about each of places (K, 3) where most beams agree, and their share (K,)."""
    noise = rng.standard_normal((len(places), _JITTER_SAMPLES, 3))
    noise *= JITTER
    noise[:, 0] = 0
    tried = wrap_headings(places[:, None] + noise)
    shares = agree(tried.reshape(-1, 3)).reshape(len(places), _JITTER_SAMPLES)
    best = shares.argmax(axis=1)[:, None]
    return np.take_along_axis(tried, best[..., None], 1)[:, 0], np.take_along_axis(shares, best, 1)[:, 0]
