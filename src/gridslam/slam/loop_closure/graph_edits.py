"""Edits of a key graph by hand: closures that a person rejects, and others, matched where a person puts a scan."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import EVALUATE_ONLY, GaussNewton
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.loop_closure import SOLVER
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submaps import build_map
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

_MATCHER = GaussNewton()
_NEAR_M = 5.0
"""A scan is put on a place if the robot was this near to it."""
_REACH_M = 0.5
_REACH_RAD = math.radians(45)
"""How far a person may put a scan off: matches begin at offsets up to these."""
_PLACED = np.diag([1 / _REACH_M**2, 1 / _REACH_M**2, 1 / math.radians(15) ** 2])
"""Information of where a person puts a scan: it counts where the match leaves a direction open, as along a corridor."""
_BEAM_SIGMA_M = 0.3
_MIN_INFORMATION = 0.06
"""Of the constraint, as those of other closures (see `PlaceMatching`)."""
_FAR = 1e6
_STARTS = np.array(list(product((-_REACH_M, 0, _REACH_M), (-_REACH_M, 0, _REACH_M), _REACH_RAD * np.arange(-3, 4) / 3)))


@final
class GraphEdit(NamedTuple):
    """A closure between two key scans, the older one first, that is rejected, or added where there is a constraint."""

    pair: tuple[int, int]
    added: Constraint | None = None


@final
class Placement(NamedTuple):
    """A key scan on the local map of another one: the measurement, and its inlier ratio, [0, 1]."""

    constraint: Constraint
    score: float


def edit_graph(graph: KeyGraph, edits: Sequence[GraphEdit]) -> None:
    """Reject closures and add others, one after the other, and solve the graph without and with them."""
    for pair, added in edits:
        if added is None:
            graph.reject(*pair)
        else:
            graph.constraints.append(added)
    graph.correct(SOLVER.solve(graph.graph()).poses)


def match_placed(
    scans: ScanArchive, poses: FloatArray, mapper: OccupancyGridMapping, key: int, placed: FloatArray
) -> Placement:
    """Match a key scan at a pose (3,) given by a person to the key scans seen there at another time.

    Raises ArgumentError where the robot of poses (T, 3) was nowhere near at another time.
    """
    away = np.hypot(*(poses - placed)[:, :2].T)
    away[np.abs(np.arange(len(poses)) - key) < 2 * KEY_SCANS_PER_SUBMAP] = np.inf
    other = int(away.argmin())
    if not away[other] <= _NEAR_M:
        raise ArgumentError("placed", f"a place within {_NEAR_M:g} m of the robot's way at another time", placed[:2])
    guess = between(poses[other], placed)
    guesses = guess + _STARTS
    maps = build_map(mapper, scans, *_local(poses, other))
    batch = scans.batch([scans.keys[key]] * len(guesses))
    matches = _MATCHER.match_scans(maps, guesses, 1e-6 * np.eye(3), batch)
    best = matches.only(int(matches.score.argmax()))
    constraint = Constraint.from_match(
        other, key, guess, best, _BEAM_SIGMA_M, _MIN_INFORMATION, ConstraintSource.BY_HAND
    )
    held = constraint._replace(information=constraint.information + _PLACED, determined=True)
    return Placement(held.in_order(), float(best.score[0]) / max(len(scans.key(key)), 1))


def score_placed(
    scans: ScanArchive, poses: FloatArray, mapper: OccupancyGridMapping, pair: tuple[int, int], measured: FloatArray
) -> float:
    """Return the inlier ratio of the second key scan, measured (3,) from the first, on the local map of the first."""
    from_, to = pair
    maps = build_map(mapper, scans, *_local(poses, from_))
    beams = scans.key(to)
    match = EVALUATE_ONLY(maps, np.zeros(1, np.int32), measured[None], np.zeros((1, 3, 3)), beams)
    return float(match.score[0]) / max(len(beams), 1)


def _local(poses: FloatArray, key: int) -> tuple[IntArray, FloatArray]:
    """Return the key scans (K,) about one, a submap's length, and their poses (K, 3) seen from it."""
    half = KEY_SCANS_PER_SUBMAP // 2
    keys = np.arange(max(key - half, 0), min(key + half + 1, len(poses)))
    return keys, between(poses[key], poses[keys])


def dump_edits(edits: Sequence[GraphEdit]) -> list[dict[str, Any]]:
    """Return edits as JSON values."""
    return [
        {"reject": [*pair]}
        if added is None
        else {"add": [*pair], "measured": added.measurement.tolist(), "information": added.information.tolist()}
        for pair, added in edits
    ]


def load_edits(values: object, key_scans: int) -> tuple[GraphEdit, ...]:
    """Return the edits of a graph that `dump_edits` gave as JSON values; raises ArgumentError for others."""
    if not isinstance(values, list):
        raise ArgumentError("edits", "a list", values)
    return tuple(_load(value, key_scans) for value in values)


def _load(value: object, key_scans: int) -> GraphEdit:
    if not isinstance(value, Mapping):
        raise ArgumentError("edits", "objects", value)
    pair = value.get("add", value.get("reject"))
    if not (isinstance(pair, list) and len(pair) == 2 and all(type(key) is int for key in pair)):
        raise ArgumentError("edits", "two key scans to add or reject", pair)
    from_, to = pair
    if not 0 <= from_ < to < key_scans:
        raise ArgumentError("edits", f"two of {key_scans} key scans, the older one first", pair)
    if "add" not in value:
        return GraphEdit((from_, to))
    try:
        measured, information = (np.array(value[name], np.float64) for name in ("measured", "information"))
    except (KeyError, TypeError, ValueError):
        raise ArgumentError("edits", "numbers measured (3) and information (3, 3)", value) from None
    checked = PoseGraph.of(np.zeros((2, 3)), [[0, 1]], measured, information)
    if np.abs(checked.measurements).max() > _FAR or np.abs(checked.information).max() > _FAR**2:
        raise ArgumentError("edits", f"numbers up to {_FAR:g}", value)
    own = checked.measurements[0], checked.information[0]
    return GraphEdit((from_, to), Constraint(from_, to, *own, ConstraintSource.BY_HAND, True))
