"""Matching key scans to the submaps of other times that lie about them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, constraints_from_matches
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph, anchor_of, first_key_scan
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import build_map, key_scans_of
from gridslam.types import FloatArray, IntArray

_RECENT_SUBMAPS = 3
"""Submaps so near in time that the tracker has matched them already, if no gap in the laser data lies between."""

_KEY_SCANS_AT_A_TIME = 32
"""Key scans compared with the submaps around them together: neighbours share most submaps."""

VISIT_GAP = 3
"""Key scans farther apart than this in time belong to different visits of a submap."""
_MAX_DISTANCE_M = 3.0
"""A key scan is matched to submaps with a key scan this near."""
_MAX_SUBMAPS = 3
"""The nearest of them."""
_INLIER_RATIO = 0.7
"""Minimum inlier ratio."""
_MIN_INFORMATION = 0.1
"""Least eigenvalue of the position's information, per agreeing beam."""
_MAX_CORRECTION_M = 0.4
"""Maximum correction of a match."""
_BEAM_SIGMA_M = 0.05
"""Standard deviation of one beam, inflated for correlated beams and cell size. Constraints of one visit, of
consecutive key scans to one submap, share its errors: their information is that of one, divided among them."""
_MATCHER = GaussNewton()
"""How a key scan is matched."""


def match_key_scans(
    closure_state: LoopClosureState,
    poses: FloatArray,
    mapper: OccupancyGridMapping,
    on_progress: Callable[[], None],
) -> Iterator[Constraint]:
    """Match key scans to overlapping submaps that are rebuilt from poses (T, 3).

    Only submaps of the same rigid component (see `KeyGraph.label_rigid_components`): across a gap in the laser data,
    nearby poses are no evidence of a revisit. Frozen key scans are not matched to each other.
    """
    wanted = _nearby_key_scans(closure_state, poses)
    loose = 1e-6 * np.eye(3)
    for submap, members in enumerate(wanted):
        if not members:
            continue
        on_progress()
        anchor = anchor_of(submap)
        keys = key_scans_of(submap, closure_state.graph)
        maps = build_map(mapper, closure_state.scans, keys, between(poses[anchor], poses[keys]))
        maps.threads = closure_state.threads
        batch = closure_state.scans.batch([closure_state.scans.keys[key] for key in members])
        guesses = between(poses[anchor], poses[members])
        matches = _MATCHER.match_scans(maps, guesses, loose, batch)
        moved = between(guesses, matches.poses)
        beams = np.diff(batch.starts)
        is_match = beams >= _MATCHER.min_beams
        is_match &= matches.score >= np.maximum(_INLIER_RATIO * beams, 1.0)
        is_match &= np.hypot(moved[:, 0], moved[:, 1]) <= _MAX_CORRECTION_M
        chosen = np.flatnonzero(is_match)
        visit: list[Constraint] = []
        for constraint in constraints_from_matches(
            anchor,
            [members[k] for k in chosen.tolist()],
            guesses[chosen],
            matches.select(chosen),
            _BEAM_SIGMA_M,
            _MIN_INFORMATION,
            ConstraintSource.PROXIMITY,
        ):
            if visit and constraint.to > visit[-1].to + VISIT_GAP:
                yield from _divide_information(visit)
                visit = []
            visit.append(constraint)
        yield from _divide_information(visit)


def _nearby_key_scans(closure_state: LoopClosureState, poses: FloatArray) -> list[list[int]]:
    """For each submap the key scans to match to it: those of which it is one of the nearest."""
    graph = closure_state.graph
    components = graph.label_rigid_components()
    submaps = graph.complete_submaps
    wanted: list[list[int]] = [[] for _ in range(submaps)]
    of_submaps = poses[: submaps * KEY_SCANS_PER_SUBMAP]
    members = of_submaps.reshape(submaps, KEY_SCANS_PER_SUBMAP, 3)
    low, high = members[:, :, :2].min(axis=1), members[:, :, :2].max(axis=1)
    for first in range(0, len(poses), _KEY_SCANS_AT_A_TIME):
        here = np.arange(first, min(first + _KEY_SCANS_AT_A_TIME, len(poses)))
        begin = poses[here, :2].min(axis=0) - _MAX_DISTANCE_M
        end = poses[here, :2].max(axis=0) + _MAX_DISTANCE_M
        near = np.flatnonzero(((high >= begin) & (low <= end)).all(axis=1))
        away = _distances(graph, components, poses, here, near)
        order = np.argsort(away, axis=1, kind="stable")[:, :_MAX_SUBMAPS]
        nearest = np.take_along_axis(away, order, axis=1)
        of_key, rank = np.nonzero(np.isfinite(nearest))
        for key, submap in zip(here[of_key].tolist(), near[order[of_key, rank]].tolist(), strict=True):
            wanted[submap].append(key)
    return wanted


def _distances(
    graph: KeyGraph, components: IntArray, poses: FloatArray, here: IntArray, submaps: IntArray
) -> FloatArray:
    """Distances (H, S), in m and half radians, of key scans `here` (H,) from submaps (S,).

    Infinite where no match is wanted.
    """
    members = first_key_scan(1) * submaps[:, None] + np.arange(KEY_SCANS_PER_SUBMAP)
    stretches = graph.label_gaps()
    own = stretches[anchor_of(0) + first_key_scan(1) * submaps]
    dx, dy, turn = np.moveaxis(poses[members] - poses[here, None, None, :], -1, 0)  # (H, S, K) each
    metres = np.hypot(dx, dy)
    is_wanted = (metres <= _MAX_DISTANCE_M) & (components[members] == components[here, None, None])
    is_wanted &= stretches[members] == own[:, None]
    away: FloatArray = np.where(is_wanted, metres + 0.5 * np.abs(wrap(turn)), np.inf).min(axis=2, initial=np.inf)
    is_left_out = np.abs(submaps - here[:, None] // KEY_SCANS_PER_SUBMAP) <= _RECENT_SUBMAPS
    is_left_out &= own == stretches[here, None]
    is_left_out |= (here[:, None] < graph.frozen) & (anchor_of(0) + first_key_scan(1) * submaps < graph.frozen)
    away[is_left_out] = np.inf
    return away


def _divide_information(visit: list[Constraint]) -> Iterator[Constraint]:
    """The constraints of one visit, which together have the information of one."""
    for constraint in visit:
        yield constraint._replace(information=constraint.information / len(visit))
