"""Bundle adjustment of scans: key scans are moved so that the surfaces that they see fit each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.matching.surfaces import Surfaces
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

_COARSE_M, _FINE_M = 0.4, 0.08
"""Largest residual of a point, in the first rounds and in the last ones."""
_SETTLED_M = 2 * _FINE_M, 0.02
"""Rounds with a gate end once no pair of key scans moves by more relative to each other. On Intel the next round moves
it by a third of that: within the fine gate, and in the end by less than the standard deviation of a point."""
_MOST_ROUNDS = 6
"""Maximum number of rounds with each gate. One or two do not close a loop that is open by half a metre: visits that
cross each other share few points, against all the motion between them."""
_SUCCESSIVE = 3
"""Key scans just before one that it is matched with; the others are spread over all that are near."""
_SCALE_RATIO = 0.25
"""Of the residual that weighs half to the largest one: visits far from each other are brought together first."""
_NOISE_PAIRS = 200
"""Pairs, spread over the log, by which the variance of a point is measured."""
_LEAST_SIGMA_M = 0.001
_FAR_M = 1e3
"""Residual of half weight, where all are to weigh the same."""
_HELD = np.eye(3)
"""Information (1/m^2, 1/rad^2) that holds a match where its surfaces leave a direction open ..."""
_LOOSE = 0.01 * _HELD
"""... and that of its result there: off by 10 m."""
LINE_REACH_M = 0.15
"""Lines are fitted to the points so near to one: at a metre five neighbouring beams give a normal that is noisy by 9
degrees."""
_SCANS_AT_A_TIME = 1024
_SCAN_ROUNDS = 2
_KEY_SCANS_BESIDE = 2
"""On either side of a scan."""
_SIGMA_M = 0.02
"""Standard deviation of a point; where the residual is as large, it weighs half in the end."""
_REACH_M = 5.0
"""Distance of key scans to be matched, at most."""
_PAIRS_PER_SCAN = 10
"""Earlier key scans that each one is matched with."""
_MIN_POINTS = 10
"""Matched points of a pair, at least."""
_MAX_CORRECTION_M = 0.15
"""A scan between key scans that moves farther stays where the motion has it."""
_CLOSE = 0.01
"""Step, in m and rad, after which a scan is where it fits and is not matched again."""
_PRIOR_SIGMA_M = 0.02
_PRIOR_SIGMA_RAD = 0.01
"""How well the motion from the key scans about it determines such a scan."""


def adjust_key_scans(
    graph: PoseGraph,
    surfaces: Surfaces,
    fives: Surfaces,
    components: IntArray,
    threads: int = 1,
) -> tuple[PoseGraph, float]:
    """Return the graph with its key scans moved and the measurements of all pairs, and the variance (m^2) of a point.

    The distances between the surfaces of key scans that are near each other are minimized, together with the graph's
    error: each round matches pairs of key scans, point to line, and solves the graph with one measurement more for each
    pair: the relative pose that fits best, with the information of its points. Their variance is measured in the round
    before. A scan takes part in several pairs, which share its information (see `share_information`): counted fully in
    each, it would outweigh the motion where surfaces determine little.

    Parameters
    ----------
    graph : PoseGraph
        What else is known of the key scans.
    surfaces, fives : Surfaces
        Of the key scans: of longer lines, which are matched, and of five beams, whose points are as they were measured.
    components : (T,) int64
        Component of each key scan; those of different ones are not matched to each other.
    """
    pairs = select_pairs(graph.poses)
    pairs = pairs[np.diff(components[pairs])[:, 0] == 0]
    poses, variance = graph.poses, _SIGMA_M**2
    for gate_m, settled_m in zip((_COARSE_M, _FINE_M), _SETTLED_M, strict=True):
        for _ in range(_MOST_ROUNDS):
            whole = _measure(graph.with_poses(poses), surfaces, pairs, gate_m, variance, threads)
            pairs = whole.edges[len(graph.edges) :]  # what does not see the other's surfaces does not in the next round
            if not len(pairs):
                break
            before, poses = poses, GraphSlam(first_guess="given", robust=None, max_iterations=1).solve(whole).poses
            variance = _measure_variance(fives, poses, pairs)
            if _greatest_relative_move_m(pairs, before, poses) < settled_m:
                break
    return _measure(graph.with_poses(poses), surfaces, pairs, _FINE_M, variance, threads), variance


def _greatest_relative_move_m(pairs: IntArray, before: FloatArray, after: FloatArray) -> float:
    """Return the greatest change (m) of the relative position of pairs (P, 2) of key scans."""
    from_, to = pairs.T
    change = between(after[from_], after[to]) - between(before[from_], before[to])
    return float(np.hypot(change[:, 0], change[:, 1]).max())


def share_information(pairs: IntArray) -> FloatArray:
    """Shares (P,) of the information of pairs (P, 2) of scans that count, as each scan's noise is in several of them.

    A surface that is not known itself and that k scans see determines their poses as all pairs among them do if each
    counts 2 / k; where a scan is in k - 1 pairs, k is taken to be that.
    """
    return np.asarray(2 / (1 + np.bincount(pairs.ravel())[pairs].mean(axis=1)), np.float64)


def _measure_variance(fives: Surfaces, poses: FloatArray, pairs: IntArray) -> float:
    """Return the variance (m^2) of a point that is hit head on."""
    some = pairs[:: -(-len(pairs) // _NOISE_PAIRS) or 1]
    found = fives.match(poses, some, _FINE_M, _FAR_M, by_incidence=True)
    points = max(int(found.counts.sum()), 1)
    mean_weight = float(np.trace(found.information[:, :2, :2].sum(axis=0))) / points
    return max(0.5 * mean_weight * float(found.squares.sum()) / points, _LEAST_SIGMA_M**2)


def _measure(
    graph: PoseGraph, surfaces: Surfaces, pairs: IntArray, gate_m: float, variance: float, threads: int
) -> PoseGraph:
    """Add measurements of pairs (P, 2) of key scans to a graph: the relative poses where their surfaces fit."""
    scale_m = max(_SIGMA_M, _SCALE_RATIO * gate_m)
    found = surfaces.match(graph.poses, pairs, gate_m, scale_m, by_incidence=True, threads=threads)
    is_matched = found.counts >= _MIN_POINTS
    own = pairs[is_matched]
    weights = share_information(own) / (2 * variance)
    information = weights[:, None, None] * found.information[is_matched]
    steps = -np.linalg.solve(information + _HELD, (weights[:, None] * found.gradients[is_matched])[..., None])
    measurements = compose(between(graph.poses[own[:, 0]], graph.poses[own[:, 1]]), steps[..., 0])
    return replace(
        graph,
        edges=np.concatenate([graph.edges, own]),
        measurements=np.concatenate([graph.measurements, measurements]),
        information=np.concatenate([graph.information, information + _LOOSE]),
        trusted=np.append(graph.trusted, np.zeros(len(own), np.bool_)),
    )


def match_scans(
    poses: FloatArray,
    keys: IntArray,
    archive: ScanArchive,
    surfaces: Surfaces,
    key_poses: FloatArray,
    variance: float,
    threads: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Match scans to the key scans about them; poses (N, 3) of all scans, information (N, 3, 3) of each match.

    Key scans stay as they are. The information is in the frame of the scan, and that of its points once, in however
    many key scans they are found; 0 for what was not matched.

    Parameters
    ----------
    poses : (N, 3) float64
        Of the last N scans of the archive, as the motion between key scans has them.
    keys : (N,) int64
        The key scan at or before each.
    archive : ScanArchive
        Where the scans are.
    surfaces, key_poses : Surfaces, (T, 3) float64
        Of the key scans.
    variance : float, m^2
        Of a point.
    """
    matched, known = poses.copy(), np.zeros((len(poses), 3, 3))
    prior = np.diag(1 / np.square([_PRIOR_SIGMA_M, _PRIOR_SIGMA_M, _PRIOR_SIGMA_RAD]))
    is_between = np.diff(keys, prepend=-1) == 0  # a drive begins with a key scan
    for begin in range(0, len(poses), _SCANS_AT_A_TIME):
        own = begin + np.flatnonzero(is_between[begin : begin + _SCANS_AT_A_TIME])
        if not len(own):
            continue
        batch = archive.batch((own + len(archive) - len(poses)).tolist())
        about = keys[own][:, None] + np.arange(1 - _KEY_SCANS_BESIDE, 1 + _KEY_SCANS_BESIDE)
        about = np.clip(about, 0, len(key_poses) - 1)
        low, high = int(about.min()), int(about.max()) + 1
        whole = surfaces.of_scans(low, high).append(Surfaces.of(batch, LINE_REACH_M, threads))
        pairs = np.stack(np.broadcast_arrays(about - low, high - low + np.arange(len(own))[:, None]), -1)
        at = poses[own]
        far = np.ones(len(own), np.bool_)  # from where they were before the step, so that they are matched again
        of_own = np.zeros((len(own), 3, 3))
        for _ in range(_SCAN_ROUNDS):
            seen_from = np.concatenate([key_poses[low:high], at])
            found = whole.match(
                seen_from, pairs[far].reshape(-1, 2), _FINE_M, _SIGMA_M, both=False, by_incidence=True, threads=threads
            )
            weight = (found.counts >= _MIN_POINTS)[:, None] / (2 * _SIGMA_M**2)
            shape = (-1, 2 * _KEY_SCANS_BESIDE, 3)
            information = (weight[..., None] * found.information).reshape(*shape, 3).sum(axis=1)
            gradients = (weight * found.gradients).reshape(shape).sum(axis=1)
            gradients += between(poses[own][far], at[far]) @ prior
            matches = np.maximum((weight > 0).reshape(-1, 2 * _KEY_SCANS_BESIDE).sum(axis=1), 1)
            of_own[far] = information * (2 * _SIGMA_M**2 / (variance * matches))[:, None, None]
            steps = -np.linalg.solve(information + prior, gradients[..., None])[..., 0]
            at[far] = compose(at[far], steps)
            far[far] = np.abs(steps).max(axis=1) > _CLOSE
        is_near = np.hypot(*(at - poses[own])[:, :2].T) < _MAX_CORRECTION_M
        matched[own[is_near]], known[own[is_near]] = at[is_near], of_own[is_near]
    return matched, known


def select_pairs(poses: FloatArray) -> IntArray:
    """Select pairs (P, 2) of key scans at poses (T, 3) to be matched: the last ones, and some of the others."""
    pairs: list[tuple[int, int]] = []
    for to in range(1, len(poses)):
        away = np.hypot(*(poses[:to, :2] - poses[to, :2]).T)
        near = np.flatnonzero(away < _REACH_M)
        last = near[near >= to - _SUCCESSIVE]
        others = near[near < to - _SUCCESSIVE]
        few = min(len(others), max(_PAIRS_PER_SCAN - _SUCCESSIVE, 0))
        chosen = others[np.rint(np.linspace(0, len(others) - 1, few)).astype(np.int64)] if few else others[:0]
        pairs += [(from_, to) for from_ in (*chosen.tolist(), *last.tolist())]
    return np.array(pairs, np.int64).reshape(-1, 2)
