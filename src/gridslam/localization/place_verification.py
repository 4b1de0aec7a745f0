"""Verification of a found place: the whole map is searched for others that the last scans fit as well.

Particles may leave the true place by chance, before any scan has refuted it. So before a place is reported as found, no
other one may explain the scans that were taken since it was assumed. Nor may the robot be outside what is mapped: most
maps end somewhere, and there is always a place in them that looks most like a corridor beyond.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Annotated, NamedTuple

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.localization.belief import (
    PoseHypotheses,
    cluster_bins,
    compute_evidence,
    is_in_cluster,
    refine_places,
    without_refuted,
)
from gridslam.localization.known_map import KnownMap
from gridslam.localization.recovery import SAMPLES_MAX, SAMPLES_PER_M2, SEARCH_SCALE_M
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.types import BeamEnds, FloatArray

_BEAMS = 60


class RecentScans(NamedTuple):
    """The last scans that updated the particles, the newest one last.

    Attributes
    ----------
    poses : (M, 3) float64
        The robot at these scans, by the motion between them; in the frame of the first one.
    ends : (M, 60, 2) float64, m
        Ends of evenly spaced beams in the base frame; of fewer beams some occur repeatedly.
    origins : (M, 2) float64, m
        The laser in the base frame.
    """

    poses: Annotated[FloatArray, "M", 3]
    ends: Annotated[FloatArray, "M", _BEAMS, 2]
    origins: Annotated[FloatArray, "M", 2]

    def append(self, moved: FloatArray, beams: BeamEnds, most: int) -> RecentScans:
        """Add a scan that was taken after the robot has `moved` (3,), and forget all but the newest `most`."""
        some = beams.ends[np.arange(_BEAMS) * len(beams.ends) // _BEAMS]
        pose = compose(self.poses[-1], moved) if len(self.poses) else np.zeros(3)
        return RecentScans(
            np.concatenate([self.poses, pose[None]])[-most:],
            np.concatenate([self.ends, some[None]])[-most:],
            np.concatenate([self.origins, beams.origin[None]])[-most:],
        )


NO_SCANS = RecentScans(np.empty((0, 3)), np.empty((0, _BEAMS, 2)), np.empty((0, 2)))

_THROUGH_RATIO = 0.02
"""Ratio of beams through walls that is no evidence of being outside the map, nor against it. In simulated half
buildings 99 % of right places have less than 0.01 over the last scans, and wrong ones 0.06; in a real floor's map of
another year, in which a tenth of the beams ends at new things, right ones have 0.003."""

_ALIKE, _UNLIKE = 1.0, 3.0
"""Nats against a place: by less in one scan it looks like the reported one, by more in all scans no longer."""

_OUTSIDE_PRIOR = 2.5
_OUTSIDE_LOG_ODDS = 35.0
"""Log odds of being outside the map before any scan, and by how much a scan changes them if all beams went through
walls: six scans without such a beam refute it."""

_OUTSIDE_LIMITS = -12.0, 12.0
"""Some scans through a door that the map has closed do not reject a place that many have confirmed, nor do scans of one
more room that looks like a mapped one confirm a place that many have rejected: 3.5 m without beams through walls do."""

CERTAINLY_INSIDE = _OUTSIDE_LIMITS[0]
"""Log odds of being outside the map where the pose is given."""


MOST_SCANS = 48
"""So many of the last scans are remembered: one each 0.2 m, so that the first is 10 m away. Poses are refined at each,
so the drift of the odometry does not matter."""

_MAX_PLACES = 256
"""So many clusters are followed backward, those with most agreeing beams."""


def find_rivals(
    known_map: KnownMap,
    reported: FloatArray,
    recent: RecentScans,
    match: Callable[[FloatArray], FloatArray],
    rng: np.random.Generator,
) -> tuple[PoseHypotheses, float]:
    """Find the places that the scans do not distinguish from a reported pose (3,), and how soon they refute others.

    The whole map is searched. Poses spread evenly over the free space are compared with the newest scan. The best one
    of each cluster is moved to where the scan fits best, and followed backward through the scans before, as
    `update_hypotheses` follows hypotheses forward. Those that no scan refutes are found, and later scans have to refute
    them.

    Parameters
    ----------
    recent : RecentScans
        One at least.
    match : callable
        Moves poses (K, 3) to where the newest scan fits best.

    Returns
    -------
    PoseHypotheses
        Places at the newest scan, and their odds relative to the reported one.
    float, m
        Mean way after which places that look alike in the newest scan are refuted; 0 if there are none. By the
        maximum likelihood for exponential survival: all ways together, those of places that are not refuted yet
        among them, by the number of refuted ones.

    References
    ----------
    After A. Milstein, J. Sanchez and E. Williamson, Robust global localization using clustered particle
    filtering (AAAI 2002): places are compared until all but one are refuted.
    """
    places = match(_search(known_map, recent.ends[-1], rng))
    places = places[~is_in_cluster(places, reported)]
    odds, alike, alike_m, way_m = np.zeros(len(places)), np.ones(len(places), bool), np.zeros(len(places)), 0.0
    for k, _, agreement in _follow_back(known_map, np.concatenate([reported[None], places]), recent, rng):
        odds += compute_evidence(agreement[1:] - agreement[0])
        if k + 1 < len(recent.poses):
            way_m += math.dist(recent.poses[k, :2], recent.poses[k + 1, :2])
        else:
            alike = odds > -_ALIKE
        alike_m[odds > -_UNLIKE] = way_m
    refuted = int((odds[alike] <= -_UNLIKE).sum())
    return without_refuted(places, odds), float(alike_m[alike].sum()) / max(refuted, 1)


def compute_outside_log_odds(
    known_map: KnownMap,
    reported: FloatArray,
    recent: RecentScans,
    rng: np.random.Generator,
) -> float:
    """Return the log odds of being outside the map against being at a reported pose (3,).

    Beams that end before the walls of a map are no evidence: people and furniture come and go. Those that went
    through walls contradict the place, at any of the last scans.
    """
    log_odds = _OUTSIDE_PRIOR
    for k, followed, _ in _follow_back(known_map, reported[None], recent, rng):
        log_odds += _outside_evidence(known_map, followed[0], recent.ends[k], recent.origins[k])
    return float(np.clip(log_odds, *_OUTSIDE_LIMITS))


def update_outside_log_odds(log_odds: float, known_map: KnownMap, reported: FloatArray, recent: RecentScans) -> float:
    """Return these log odds after one more scan, the newest one, at the same place."""
    added = _outside_evidence(known_map, reported, recent.ends[-1], recent.origins[-1])
    return float(np.clip(log_odds + added, *_OUTSIDE_LIMITS))


def bound_outside_log_odds(log_odds: float, driven_m: float, alike_m: float) -> float:
    """Return these log odds, but no less than by for how long places of this map look alike.

    Outside the map there are such places, too, and the scans refute them no sooner. So where those in the map are
    alike for `alike_m`, a place that agreed for `driven_m` is no more certain than exp(-driven_m / alike_m).
    """
    return max(log_odds, _OUTSIDE_PRIOR - driven_m / max(alike_m, 1e-9))


def _search(known_map: KnownMap, ends: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return poses (K, 3) where most beams with these ends agree, one of each cluster, the best first."""
    count = int(min(SAMPLES_PER_M2 * known_map.free_area_m2, SAMPLES_MAX)) + 1
    poses = known_map.sample_poses(count, rng)
    scores = known_map.inlier_ratio(ends[::2], CauchyEndPoint(scale_m=SEARCH_SCALE_M, tempering=1.0))(poses)
    order = np.argsort(-scores, kind="stable")
    best = np.unique(cluster_bins(*poses[order].T.copy()), return_index=True)[1]
    return poses[order[np.sort(best)[:_MAX_PLACES]]]


def _follow_back(
    known_map: KnownMap, places: FloatArray, recent: RecentScans, rng: np.random.Generator
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Follow places (K, 3) at the newest scan back through all; yield each scan's number, its poses and agreement."""
    for k in reversed(range(len(recent.poses))):
        if k + 1 < len(recent.poses):
            places = compose(places, between(recent.poses[k + 1], recent.poses[k]))
        places, agreement = refine_places(places, known_map.inlier_ratio(recent.ends[k]), rng)
        yield k, places, agreement


def _outside_evidence(known_map: KnownMap, pose: FloatArray, ends: FloatArray, origin: FloatArray) -> float:
    """Return log odds by the ratio of beams with ends (B, 2) that went through a wall, seen from a pose (3,)."""
    return _OUTSIDE_LOG_ODDS * (float(known_map.went_through(pose, ends, origin).mean()) - _THROUGH_RATIO)
