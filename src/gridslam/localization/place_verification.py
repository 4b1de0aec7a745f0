"""Verification of a found place: the whole map is searched for others that the last scans fit as well.

Particles may leave the true place by chance, before any scan has refuted it. So before a place is reported as found, no
other one may explain the scans that were taken since it was assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.localization.belief import HypothesisTracker, PoseHypotheses, cluster_bins
from gridslam.localization.known_map import KnownMap
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray

__all__ = ["NO_SCANS", "PlaceVerification", "RecentScans"]

_BEAMS = 60


class RecentScans(NamedTuple):
    """The last scans that updated the particles, the newest one last.

    Attributes
    ----------
    poses : (M, 3) float64
        The robot at these scans, by the motion between them; in the frame of the first one.
    ends : (M, 60, 2) float64, m
        Ends of evenly spaced beams in the base frame; of fewer beams some occur repeatedly.
    """

    poses: Annotated[FloatArray, "M", 3]
    ends: Annotated[FloatArray, "M", _BEAMS, 2]

    def append(self, moved: FloatArray, ends: FloatArray, most: int) -> RecentScans:
        """Add a scan with ends (K, 2), taken after the robot has `moved` (3,), and forget all but the newest `most`."""
        some = ends[np.arange(_BEAMS) * len(ends) // _BEAMS]
        pose = compose(self.poses[-1], moved) if len(self.poses) else np.zeros(3)
        poses = np.concatenate([self.poses, pose[None]])[-most:]
        return RecentScans(poses, np.concatenate([self.ends, some[None]])[-most:])


NO_SCANS = RecentScans(np.empty((0, 3)), np.empty((0, _BEAMS, 2)))


@final
@parameters(frozen=True)
class PlaceVerification:
    """Searches the whole map for places that fit the last scans as well as the reported one.

    Poses spread evenly over the free space are compared with the newest scan. The best one of each cluster is moved to
    where the scan fits best, and followed backward through the scans before, as `HypothesisTracker` follows hypotheses
    forward. Those that no scan refutes become hypotheses, which later scans have to refute.

    Parameters
    ----------
    scans : int, >= 0
        So many of the last scans are remembered: of 48, one each 0.2 m, the first is 10 m away. Poses are refined at
        each, so the drift of the odometry does not matter. 0: no verification.
    samples_per_m2 : float, 1/m^2, > 0
        How many poses are compared with the newest scan: 500 put ten within 0.3 m and 10 degrees of every pose.
    samples_max : int, >= 1
        At most.
    scale_m : float, m, > 0
        Distance at which a beam agrees by half there: as wide as these poses are apart.
    places_max : int, >= 1
        So many clusters are followed backward, those with most agreeing beams.

    References
    ----------
    After A. Milstein, J. Sanchez and E. Williamson, Robust global localization using clustered particle
    filtering (AAAI 2002): places are compared until all but one are refuted.
    """

    scans: int = bounded(48, ge=0, le=10_000)
    samples_per_m2: float = bounded(500.0, ge=1e-9, le=1e4)
    samples_max: int = bounded(1_000_000, ge=1, le=10_000_000)
    scale_m: float = bounded(0.2, ge=1e-6, le=1e6)
    places_max: int = bounded(256, ge=1, le=100_000)

    def __call__(
        self,
        known_map: KnownMap,
        reported: FloatArray,
        recent: RecentScans,
        match: Callable[[FloatArray], FloatArray],
        tracker: HypothesisTracker,
        rng: np.random.Generator,
    ) -> PoseHypotheses:
        """Find the places that the scans do not distinguish from a reported pose (3,).

        Parameters
        ----------
        recent : RecentScans
            One at least.
        match : callable
            Moves poses (K, 3) to where the newest scan fits best.
        tracker : HypothesisTracker
            Compares places by a scan.

        Returns
        -------
        PoseHypotheses
            Places at the newest scan, and their odds relative to the reported one.
        """
        places = match(self._search(known_map, recent.ends[-1], rng))
        followed = np.concatenate([reported[None], places])
        odds = np.zeros(len(places))
        for k in reversed(range(len(recent.poses))):
            if k + 1 < len(recent.poses):
                followed = compose(followed, between(recent.poses[k + 1], recent.poses[k]))
            agree = known_map.inlier_ratio(recent.ends[k])
            followed, agreement = tracker.refine(followed, agree, rng)
            odds += tracker.evidence(agreement[1:] - agreement[0])
        return tracker.without_refuted(places, odds)

    def _search(self, known_map: KnownMap, ends: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return poses (K, 3) where most beams with these ends agree, one of each cluster, the best first."""
        count = int(min(self.samples_per_m2 * known_map.free_area_m2, self.samples_max)) + 1
        poses = known_map.sample_poses(count, rng)
        scores = known_map.inlier_ratio(ends[::2], CauchyEndPoint(scale_m=self.scale_m, tempering=1.0))(poses)
        order = np.argsort(-scores, kind="stable")
        best = np.unique(cluster_bins(*poses[order].T.copy()), return_index=True)[1]
        return poses[order[np.sort(best)[: self.places_max]]]
