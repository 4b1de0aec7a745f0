"""What is judged of a run against the truth: constraints, revisits that were recognized, errors of the trajectory."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from closure_errors import OPEN_M, closure_errors
from gridslam.config import Configuration, build
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray
from recognition_drives import APART_M

_FALSE_M, _FALSE_RAD = 0.5, math.radians(8.0)
_RIGHT_M, _RIGHT_RAD = 0.2, math.radians(3.0)
_BESIDE_M = 0.5  # a run has other key scans than those by which revisits were found
_BESIDE_WAY_M = 5.0  # half the way from one submap to the next


class Mapped(NamedTuple):
    """What a run says: poses (N, 3) told at the end and at the time, the graph, its key scans (T,), CPU seconds.

    `searched` (K, 2) are the constraints that come from a search; others were matched where the map had them already.
    """

    full: FloatArray
    online: FloatArray
    graph: PoseGraph
    keys: IntArray
    searched: IntArray
    cpu_s: float


class Score(NamedTuple):
    """One drive: its certain revisits and those recognized; constraints, right, false, and false by search; m."""

    certain: int
    recognized: int
    right: int
    false: int
    false_searched: int
    full_m: float
    online_m: float
    filter_m: float
    filter_off_m: float
    full_off_m: float
    cpu_s: float


def mapped(measurements: list[Measurement], config: Configuration) -> Mapped:
    """Map a log as `map_log` does, nothing in it repaired."""
    recorder, began = TrajectoryRecorder(), time.process_time()
    rng = np.random.default_rng(0)
    state = run(measurements, build(config), rng=rng, observers=[recorder])
    said = full_slam(state, [recorder.tracked_scans()], config.mapper, config.loop_closure)
    keys = np.flatnonzero(np.diff(recorder.keys, prepend=-1))
    searched = np.empty((0, 2), np.int64) if said.loop_summary is None else said.loop_summary.closures
    return Mapped(
        said.poses, recorder.online_trajectory().poses, said.graph, keys, searched, time.process_time() - began
    )


def kept(graph: PoseGraph) -> NDArray[np.bool_]:
    """Which constraints (M,) beyond the chain the answer keeps: it follows them, and they say something."""
    metres, radians = closure_errors(graph.poses, graph.edges, graph.measurements, graph.information)
    told = np.linalg.eigvalsh(graph.information[:, :2, :2])[:, -1] >= OPEN_M**-2
    followed = (metres <= _FALSE_M) & (radians <= _FALSE_RAD)
    return ~graph.trusted & (np.abs(np.diff(graph.edges)[:, 0]) > 1) & told & followed


def judge(
    truth: FloatArray, driven: FloatArray, said: Mapped, arcs: FloatArray, *, by_way: bool = False
) -> tuple[int, int, int, int]:
    """Count the arcs recognized, the right constraints, the false ones, and those of these that a search gave.

    A place is recognized by a constraint that determines its position; `by_way` one that leaves a direction open will
    do, as along a corridor, and it may end 5 m before or after.

    Parameters
    ----------
    truth, driven : (N, 3), (N,)
        True poses of the log's scans, and metres driven up to each, blackouts included.
    said : Mapped
    arcs : (R, 2)
        Certain revisits, in metres driven.
    """
    graph, poses, at = said.graph, truth[said.keys], driven[said.keys]
    which = kept(graph)
    edges, measured, known = graph.edges[which], graph.measurements[which], graph.information[which]
    if not len(edges):
        return 0, 0, 0, 0
    metres, radians = closure_errors(poses, edges, measured, known)
    false = (metres > _FALSE_M) | (radians > _FALSE_RAD)
    determined = np.linalg.eigvalsh(known[:, :2, :2])[:, 0] >= OPEN_M**-2
    ends = np.sort(at[edges], axis=1)
    right = (metres <= _RIGHT_M) & (radians <= _RIGHT_RAD) & (determined | by_way) & (np.diff(ends)[:, 0] >= APART_M)
    later = ends[right, 1]
    beside_m = _BESIDE_WAY_M if by_way else _BESIDE_M
    recognized = [bool(((later >= a - beside_m) & (later <= b + beside_m)).any()) for a, b in arcs]
    found = set(map(tuple, said.searched.tolist()))
    by_search = sum(tuple(pair) in found for pair in edges[false].tolist())
    return sum(recognized), int(right.sum()), int(false.sum()), by_search


def off_m(truth: FloatArray, poses: FloatArray) -> FloatArray:
    """How far poses (N, 3) are off (N,), the first being where it is."""
    away = between(between(truth[0], truth), between(poses[0], poses))
    return np.hypot(away[:, 0], away[:, 1])


def rmse(values: FloatArray) -> float:
    return math.sqrt(float(np.square(values).mean()))
