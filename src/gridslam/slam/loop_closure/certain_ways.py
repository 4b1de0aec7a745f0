"""The ways through a graph of key scans along which a position is least uncertain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.geometry.se2 import between, compose, inverse
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.drift_model import position_variances
from gridslam.types import FloatArray, IntArray

_LEAST_M2 = 1e-12
"""Variance of a step at least: rounding would leave less than none."""


def follow_certain_ways(
    key: int,
    pose: FloatArray,
    others: IntArray,
    tracked: Sequence[FloatArray],
    sums: FloatArray,
    links: Sequence[Constraint],
    link_pairs: IntArray,
    link_moments: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Follow the most certain ways from a key scan to others (K,), over increments and constraints (Dijkstra).

    Parameters
    ----------
    key, pose : int, (3,) float64
        The key scan, and where it is in the map.
    tracked, sums : sequence of T (3,) float64, (T, 9) float64
        All key scans as tracked, and the moments of the increments up to each (see `compute_moments`).
    links, link_pairs, link_moments : sequence of L Constraint, (L, 2) int64, (L, 9) float64
        Constraints, by which ways may lead in either direction, their key scans and their moments.

    Returns
    -------
    (K, 3), (K, 9) float64
        The key scan as the tracker would have it if the constraints of each way were certain, and the moments of these
        ways.

    References
    ----------
    Olson, Robust and efficient robotic mapping (2008): the Dijkstra projection.
    """
    from scipy.sparse import csr_matrix  # only who closes loops pays for their import
    from scipy.sparse.csgraph import dijkstra

    count = len(sums)
    own = np.arange(count)
    pairs = np.concatenate([np.stack([own[:-1], own[1:]], axis=1), link_pairs])
    moments = np.concatenate([np.diff(sums, axis=0), link_moments])
    variances = np.maximum(position_variances(pose, moments), _LEAST_M2)
    order = np.argsort(pairs[:, 0], kind="stable")
    begins = np.searchsorted(pairs[order, 0], np.arange(count + 1))
    # several steps between two key scans stay apart, other than in a matrix made of triples, which would be their sum
    graph = csr_matrix((variances[order], pairs[order, 1], begins), (count, count))
    costs, before = dijkstra(graph, directed=False, indices=key, return_predecessors=True)
    before[key] = key
    link_into = np.full(count, -1)  # by which the way comes to each
    for from_, to in (link_pairs.T, link_pairs.T[::-1]):
        is_taken = (before[to] == from_) & (costs[from_] + variances[count - 1 :] == costs[to])
        link_into[to[is_taken]] = np.flatnonzero(is_taken)
    # where each way last came by a constraint, or where it began: from there on it follows the increments
    entries = np.where((link_into >= 0) | (own == key), own, before)
    while (entries != entries[entries]).any():
        entries = entries[entries]

    def drive(first: IntArray | int, last: IntArray | int) -> FloatArray:
        """Moments (..., 9) of the increments between two key scans, in either direction."""
        return np.asarray(np.sign(np.subtract(last, first))[..., None] * (sums[last] - sums[first]))

    needed = set[int]()
    left = set(entries[others].tolist()) - {key}
    while left:
        needed |= left
        left = {int(entries[before[entry]]) for entry in left} - needed - {key}
    reached = {key: (tracked[key], np.zeros(9))}
    for entry in sorted(needed, key=costs.__getitem__):
        last = int(before[entry])
        end, so_far = reached[int(entries[last])]
        link = links[link_into[entry]]
        measured = link.measurement if link.from_ == entry else inverse(link.measurement)
        here = compose(tracked[entry], compose(measured, between(tracked[last], end)))
        reached[entry] = here, so_far + drive(entries[last], last) + link_moments[link_into[entry]]
    ends, passed = zip(*(reached[entry] for entry in entries[others].tolist()), strict=True)
    return np.array(ends), np.array(passed) + drive(entries[others], others)
