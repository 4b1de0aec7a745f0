"""The NumPy twin of the search for the least uncertain ways over a graph of submaps."""

from __future__ import annotations

import heapq
import math

import numpy as np

from gridslam.kernels.reference_update import FloatArray, Int32Array

_Pose = tuple[float, float, float]
_Moments = tuple[float, ...]


def shortest_ways(
    firsts: FloatArray,
    steps: FloatArray,
    link_submaps: Int32Array,
    links: FloatArray,
    submap: int,
    moments: FloatArray,
    pose: FloatArray,
    x: float,
    y: float,
    limit: float,
    most: int,
    last: int,
) -> tuple[Int32Array, FloatArray, FloatArray]:
    """Find the ways from a key scan to submaps along which its position is least uncertain (Dijkstra).

    Each submap is a step away from the ones before and after it, and links join others. Moments are those of
    `gridslam.slam.loop_closure.drift_model.compute_moments`; they add up along a way.

    Parameters
    ----------
    firsts : (N, 3) float64
        The first key scan of each submap, as tracked.
    steps : (S, 9) float64
        Moments of the way from each submap to the next.
    link_submaps, links : (L, 2) int32, (L, 12) float64
        From which submap to which; the first key scan of the former seen from that of the latter, and nine moments.
    submap, moments, pose : int, (9,), (3,) float64
        Submap of the key scan, moments of its way from the first one there, and the key scan as tracked.
    x, y : float, m
        Where the key scan is in the map.
    limit : float, m^2
        Variance of the position, the trace of its covariance, at which the search ends.
    most, last : int
        It ends after this many submaps, too, and with submap `last`, if that is not -1.

    Returns
    -------
    (K,) int32, (K, 9), (K, 3) float64
        Submaps, nearest first, moments of the ways there, and the key scan as the tracker had it if they were certain.
    """
    leaving: dict[int, list[tuple[int, _Pose | None, _Moments]]] = {}
    for (begin, end), (lx, ly, turn, *own) in zip(link_submaps.tolist(), links.tolist(), strict=True):
        leaving.setdefault(begin, []).append((end, (lx, ly, turn), tuple(own)))
    ways = [tuple(own) for own in steps.tolist()]
    tracked = [(px, py, turn) for px, py, turn in firsts.tolist()]
    away = x * x + y * y
    here: _Pose = tuple(pose.tolist())
    queue = [(0.0, 0, submap, tuple(moments.tolist()), here, -1, here)]
    pushed = 0  # keeps the order of equals
    done = dict[int, tuple[_Moments, _Pose]]()
    least = dict[int, float]()
    while queue and len(done) < most and last not in done:
        cost, _, submap, so_far, end, before, step = heapq.heappop(queue)
        if submap in done:
            continue
        if before >= 0:
            end = _compose(tracked[submap], _compose(step, _between(tracked[before], end)))
        done[submap] = so_far, end
        neighbours = leaving.get(submap, [])[:]
        neighbours += [(submap - 1, None, ways[submap - 1])] if submap else []
        neighbours += [(submap + 1, None, ways[submap])] if submap < len(ways) else []
        for other, link, own in neighbours:
            if other in done:
                continue
            total = tuple(a + b for a, b in zip(so_far, own, strict=True))
            _, _, _, q, qx, qy, qxx, _, qyy = total
            across = q * away - 2 * (qx * x + qy * y) + qxx + qyy
            spread = max(cost, so_far[0] + own[0] + so_far[2] + own[2] + max(across, 0.0))
            if spread < least.get(other, limit):
                least[other] = spread
                pushed += 1
                heapq.heappush(queue, (spread, pushed, other, total, end, -1 if link is None else submap, link or here))
    found = list(done.values())
    return (
        np.array(list(done), np.int32),
        np.array([some for some, _ in found]).reshape(-1, 9),
        np.array([end for _, end in found]).reshape(-1, 3),
    )


def _compose(a: _Pose, b: _Pose) -> _Pose:
    c = math.cos(a[2])
    s = math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], _wrap(a[2] + b[2])


def _between(a: _Pose, b: _Pose) -> _Pose:
    c = math.cos(a[2])
    s = math.sin(a[2])
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    return c * dx + s * dy, c * dy - s * dx, _wrap(b[2] - a[2])


def _wrap(angle: float) -> float:
    if -math.pi <= angle < math.pi:
        return angle
    rest = math.fmod(angle, math.tau)
    return rest - math.tau if rest >= math.pi else rest + math.tau if rest < -math.pi else rest
