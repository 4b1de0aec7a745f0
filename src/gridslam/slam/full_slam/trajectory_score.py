"""Score of a trajectory: log likelihood of all scans given the map of other visits, and of the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, rotate_covariances
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import cauchy_weights, weigh_known_beams
from gridslam.scan import BeamEnds
from gridslam.slam.loop_closure.drift_model import compute_moments_of_variances, propagate_covariances
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submaps import ROW, fade
from gridslam.types import FloatArray

_BEFORE_M = 0.3
"""More than the thickness of most walls inside buildings."""


@final
@dataclass(frozen=True, slots=True)
class TrajectoryScore:
    """How probable a trajectory is, up to a constant that is the same for all trajectories of one log.

    Attributes
    ----------
    log_likelihood : float, nats
        Of the scans given the map of the earlier ones, and of the motion.
    beams : int
        Beams that end in what was mapped long before.
    agreement : float, [0, 1]
        How well these agree with it; NaN where there is none.
    motion : float, nats
        The motion's part of the log likelihood.
    """

    log_likelihood: float
    beams: int
    agreement: float
    motion: float


_SAME_VISIT_DISTANCE = 15.0
"""Path length in m, plus rotation in rad, within which mapped scans count as the same visit."""
SCALE_M = 0.1
"""Distance at which a beam agrees by half, that of the measurement model `CauchyEndPoint`."""
_TEMPERING = 0.03
"""Share of a beam's evidence that is new, as in `CauchyEndPoint`."""
NEUTRAL = 0.7
"""Agreement that speaks neither for nor against a place: scans matched to a wrong place that looks alike reach 0.6,
right ones 0.75 (furniture and people have moved) to 0.97."""
_MOTION_SIGMA = 1.0
"""The motion from one submap to the next is this many standard deviations off before its log likelihood grows slowly
(Cauchy): where the wheels slipped, or a filter closed a loop at once, one bears it all. Single increments are not
compared: a filter's poses are off by noise that does not accumulate, tracked ones by none."""
_MOTION_TEMPERING = 0.5
"""Share of its evidence that is new: errors of neighbouring increments are correlated."""


def score_trajectory(
    graph: KeyGraph,
    scans: ScanArchive,
    poses: FloatArray,
    mapper: OccupancyGridMapping,
    on_progress: Callable[[], None] = lambda: None,
) -> tuple[TrajectoryScore, TileMaps]:
    """Score poses (T, 3) of the key scans; return the map of all of them, too.

    The score is log p(z_1:t | x_1:t) + log p(x_1:t | u_1:t), tempered, up to a constant. The map is drawn scan by scan,
    and each scan is compared with what was mapped of the places around it long before, on another visit: its own time
    agrees with it in any trajectory. A beam that ends in what was mapped then agrees by 1 / (1 + (d / c)^2), d its
    distance to the nearest obstacle and c `SCALE_M`; ends in what others saw free, or behind their walls, agree with
    nothing. Beams that end in unknown cells are ignored. Doubled walls and misplaced visits reduce the score.

    References
    ----------
    The weights of Grisetti et al. 2007, accumulated along one trajectory, here over other visits only.
    """
    tracked = np.array(graph.tracked)
    way = path_lengths(tracked)
    maps = mapper.empty(1)
    after = np.searchsorted(way, way - _SAME_VISIT_DISTANCE)  # key scans that each is compared with
    agreeing = 0.0
    beams = 0
    for key in range(len(poses)):
        if graph.begins_drive(key):
            fade(maps)
        maps.update(ROW, poses[key : key + 1], scans.key(key))
        for seen in np.flatnonzero(after == key + 1).tolist():
            weights = weigh_known_beams(maps, ROW, poses[seen], scans.key(seen).ends, SCALE_M)
            agreeing += float(weights.sum(dtype=np.float64))
            beams += len(weights)
        on_progress()
    motion = _score_motion(tracked, np.array(graph.variances), poses)
    likelihood = log_likelihood(agreeing, beams) + motion
    return TrajectoryScore(likelihood, beams, agreeing / beams if beams else float("nan"), motion), maps


def log_likelihood(agreeing: float, beams: int) -> float:
    """Log likelihood (nats) of beams, given the sum of their agreement and their number."""
    return _TEMPERING * (agreeing - NEUTRAL * beams)


def weigh_same_side(maps: TileMaps, pose: FloatArray, beams: BeamEnds) -> NDArray[np.float32]:
    """Agreement (K,) of those beams seen from a pose (3,) that the one map knows from the same side.

    Their ends are known cells, and what is a bit before them: from the next room a wall is seen from behind, and
    its thickness is no disagreement.
    """
    back = beams.origin - beams.ends
    lengths = np.maximum(np.hypot(*back.T), 1e-9)[:, None]
    before = beams.ends + _BEFORE_M * back / lengths
    known = maps.is_known(0, beams.ends, pose) & maps.is_known(0, before, pose)
    return cauchy_weights(maps.distances(ROW, pose[None], beams.ends)[0, known], SCALE_M)


def _score_motion(tracked: FloatArray, variances: FloatArray, poses: FloatArray) -> float:
    """Tempered log likelihood of the motion from submap to submap, by a Cauchy density, up to a constant."""
    begins = np.arange(0, len(poses), KEY_SCANS_PER_SUBMAP)
    ends = np.append(begins[1:], len(poses) - 1)
    moved = between(tracked[begins], tracked[ends])
    errors = between(moved, between(poses[begins], poses[ends]))
    moments = np.cumsum(compute_moments_of_variances(tracked, variances), axis=0)
    spread = rotate_covariances(
        propagate_covariances(tracked[ends], moments[ends] - moments[begins]), -tracked[ends, 2]
    )
    spread += 1e-12 * np.eye(3)
    squared = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(spread), errors)
    return -_MOTION_TEMPERING * float(np.log1p(squared / _MOTION_SIGMA**2).sum())


def path_lengths(poses: FloatArray) -> FloatArray:
    """Metres and radians driven up to each of poses (T, 3), (T,)."""
    steps = np.diff(poses, axis=0)
    moved = np.hypot(steps[:, 0], steps[:, 1]) + np.abs(wrap(steps[:, 2]))
    return np.concatenate([[0.0], np.cumsum(moved)])
