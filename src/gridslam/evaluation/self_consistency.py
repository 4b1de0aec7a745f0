"""Score a trajectory by the probability of its own scans, with the map integrated out; needs no truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar, final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import compose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.mapping.beam_counts import BeamCounts
from gridslam.matching.sharpness import measure_sharpness
from gridslam.matching.surfaces import Surfaces
from gridslam.scan import LaserScan
from gridslam.types import BeamEnds, FloatArray, Trajectory

MAX_SCANS: Final = 500
"""So many scans are enough: more of them rank trajectories the same."""

_CELL_M: Final = 0.05
_PRIOR_HITS: Final = 0.05
_PRIOR_MISSES: Final = 1.0
"""Beta distribution of a cell's reflection probability: one observation, of which a twentieth is a hit. A beam passes
through 20 to 100 cells and hits one; and less than one of each, as cells reflect always or never."""

_PLACES: Final = ((0.011, 0.017, 0.2), (0.031, 0.001, 0.2 + math.pi / 6), (0.003, 0.041, 0.2 + math.pi / 3))
"""Poses of the trajectory in the grid: the score is their mean, as it depends on how walls lie in the grid."""

_NEAREST_M: Final = 0.05
_FARTHEST_M: Final = 30.0
"""Ranges that count, independent of the configuration: the default's, for the same reasons."""

_SAME_TIME_NS: Final = 1_000_000

_Item = TypeVar("_Item")


@final
@dataclass(frozen=True, slots=True)
class SelfConsistency:
    """Agreement of a trajectory with its own scans; comparable between trajectories of the same scans alone.

    Attributes
    ----------
    scans : int
        Scans that were compared, at most `MAX_SCANS`, evenly distributed over those that have a pose.
    beams : int
        Their beams.
    nats_per_beam : float, nats, > 0
        -ln p(scans | trajectory) for each beam, the map integrated out. Less is better.
    sharpness_m : float or None, m
        rms distance of points to the surfaces that other visits have seen (`measure_sharpness`); None without such.
    """

    scans: int
    beams: int
    nats_per_beam: float
    sharpness_m: float | None = None


@checked
def measure_self_consistency(trajectory: Trajectory, scans: Iterable[LaserScan]) -> SelfConsistency:
    """Score a trajectory by the probability of its own scans: how well each is predicted by the joint map of others.

    Doubled and thick walls cost in two ways: where one scan ends others pass through, and more cells are occupied than
    need be. Drawing a visit elsewhere, far from all others, costs its walls once more, and drawing all in one place
    contradicts itself: no cheap error is rewarded. The scans are drawn in a grid of its own, so that neither the
    configuration's cells nor its number of key scans has an influence. The score depends on the building and the laser,
    too: trajectories of different logs cannot be compared.

    Parameters
    ----------
    trajectory : Trajectory
        In any order of stamps.
    scans : iterable of LaserScan
        Those without a pose within 1 ms are left out; ranges from 0.05 to 30 m count.

    Raises
    ------
    ArgumentError
        No scan has a pose, or for what `score_drawn_scans` refuses.

    Notes
    -----
    Each cell reflects beams with an unknown probability, a priori beta-distributed, independently of all others. Given
    the trajectory the map can then be integrated out (Murphy 1999): a cell with h hits and m misses contributes
    ln B(a + h, b + m) - ln B(a, b). By the chain rule the sum is that of the log probability of each scan given the
    map of those before it, in any order of the scans: the prequential score of the map.

    References
    ----------
    K. Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999. D. Haehnel, *Mapping with Mobile Robots*,
    2004 (reflection probability maps). A. P. Dawid, *Statistical theory: the prequential approach*, JRSS A 1984.
    """
    sampled = sample_evenly(_pair_with_poses(trajectory, scans))
    if not sampled:
        raise ArgumentError("trajectory", "a pose within 1 ms of a scan", "none")
    return score_drawn_scans(
        [scan.beams(_NEAREST_M, _FARTHEST_M) for scan, _ in sampled], np.array([pose for _, pose in sampled])
    )


def score_drawn_scans(scans: Sequence[BeamEnds], poses: FloatArray) -> SelfConsistency:
    """Compute `measure_self_consistency` for selected beams (N) and the pose of each, (N, 3).

    Raises
    ------
    ArgumentError
        There is not one pose for each scan, a pose is not finite, no scan has a beam, or the poses are so far apart
        that no map holds all scans.
    """
    from scipy.special import betaln  # only who scores pays for its import

    if poses.shape != (len(scans), 3):
        raise ArgumentError("poses", f"shape ({len(scans)}, 3), one for each scan", poses.shape)
    if not np.isfinite(poses).all():
        raise ArgumentError("poses", "finite x, y, theta", "a value that is not finite")
    beams = sum(map(len, scans))
    if not beams:
        raise ArgumentError("scans", "at least one beam", "none")
    evidence = 0.0
    for place in _PLACES:
        counts = BeamCounts(_CELL_M)
        for scan, pose in zip(scans, compose(np.array(place), poses), strict=True):
            if len(scan):
                counts.add(pose, scan)
        hits, misses = counts.observed()
        cells = betaln(_PRIOR_HITS + hits, _PRIOR_MISSES + misses) - betaln(_PRIOR_HITS, _PRIOR_MISSES)
        evidence += float(cells.sum())
    sharpness_m = measure_sharpness(Surfaces.of(ScanBatch.of(scans)), poses)
    return SelfConsistency(len(scans), beams, -evidence / (len(_PLACES) * beams), sharpness_m)


def sample_evenly(items: Iterable[_Item], most: int = MAX_SCANS) -> list[_Item]:
    """Take every k-th item from the first on, k the least power of two that leaves at most `most` >= 1 of them."""
    step = 1
    taken: list[_Item] = []
    for index, item in enumerate(items):
        if index % step:
            continue
        taken.append(item)
        if len(taken) > most:
            del taken[1::2]
            step *= 2
    return taken


def _pair_with_poses(trajectory: Trajectory, scans: Iterable[LaserScan]) -> Iterator[tuple[LaserScan, FloatArray]]:
    """Yield scans with the pose nearest in time, if within 1 ms."""
    order = np.argsort(trajectory.stamps_ns, kind="stable")
    stamps = trajectory.stamps_ns[order]
    for scan in scans:
        at = int(np.searchsorted(stamps, scan.stamp_ns))
        about = stamps[max(at - 1, 0) : at + 1]
        away = np.abs(about - scan.stamp_ns)
        if len(away) and away.min() <= _SAME_TIME_NS:
            yield scan, trajectory.poses[order[max(at - 1, 0) + int(away.argmin())]]
