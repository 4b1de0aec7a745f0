"""Marginal covariances of a solved pose graph, without inverting its information matrix."""

from __future__ import annotations

from typing import Any

import numpy as np

from gridslam.slam.pose_graph.linear import BlockSystem, linearize, require_connected
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray


def marginal_covariances(graph: PoseGraph) -> FloatArray:
    """Covariances (N, 3, 3) in m^2, m rad and rad^2 of all poses, map frame; 0 for what is held.

    Those of the normal distribution about the poses (Laplace's approximation), given the poses that are held, by the
    blocks of the inverse that the factor's pattern holds; right as far as the information of the measurements is.

    Parameters
    ----------
    graph : PoseGraph
        Solved; for a robust solution `GraphSolution.weighted_graph`.

    Raises
    ------
    ArgumentError
        The measurements do not join all poses.
    """
    require_connected(graph.edges, len(graph.poses))
    blocks = np.zeros((len(graph.poses), 3, 3))
    if len(graph.poses) > graph.held:
        lower, pivots, order = _factorize(graph)
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        blocks[graph.held :] = _selected_inverse(lower, np.asarray(pivots), place.reshape(-1, 3))
    return blocks


def _factorize(graph: PoseGraph) -> Any:  # noqa: ANN401 scipy's sparse matrix, and arrays
    """Factors of the information of a graph (see `BlockSystem.factors`): they alone stay in memory."""
    system = BlockSystem(graph.edges, len(graph.poses), 3, graph.held)
    system.factorize(system.assemble(linearize(graph, graph.poses, graph.errors()))[0])
    return system.factors()


def _selected_inverse(lower: Any, pivots: FloatArray, wanted: IntArray) -> FloatArray:  # noqa: ANN401 scipy's matrix
    """Blocks (K, s, s) of the inverse of L D L' at places `wanted` (K, s), each a block of the matrix inverted.

    Takahashi's recurrence, from the last column to the first, by supernodes: columns S that follow each other and have
    the same rows R below them. With G = L_RS L_SS^-1,

        Z_RS = -Z_RR G,    Z_SS = L_SS^-T D_S^-1 L_SS^-1 - G' Z_RS,

    and Z_RR is part of the front (S and R) of the supernode that holds the first of R, the parent in the elimination
    tree. All there is to do are dense products of small matrices.

    Source: Takahashi, Fagan, Chin (1973); Erisman, Tinney, On computing certain elements of the inverse (1975).
    """
    begin = lower.indptr
    rows = lower.indices
    numbers = lower.data
    starts = _supernodes(begin, rows)
    node_of = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    last = begin[starts[1:] - 1], begin[starts[1:]]  # where the rows below each supernode stand
    has_parent = last[0] < last[1]
    children = np.bincount(node_of[rows[last[0][has_parent]]], minlength=len(starts))
    asked = np.argsort(wanted.min(axis=1))
    asked_from = np.searchsorted(wanted.min(axis=1)[asked], starts)
    blocks = np.empty((*wanted.shape, wanted.shape[1]))
    fronts: dict[int, tuple[IntArray, FloatArray]] = {}
    for node in range(len(starts) - 2, -1, -1):
        a = starts[node]
        b = starts[node + 1]
        below = rows[last[0][node] : last[1][node]]
        places = np.concatenate((np.arange(a, b), below))
        inner = np.empty((0, 0))
        if has_parent[node]:
            parent = int(node_of[below[0]])
            of_parent, outer = fronts[parent]
            at = np.searchsorted(of_parent, below)
            inner = outer[at[:, None], at]
            children[parent] -= 1
            if not children[parent]:
                del fronts[parent]
        inverse = _invert_front(numbers[begin[a] : begin[b]], pivots[a:b], inner)
        if children[node]:
            fronts[node] = places, inverse
        here = asked[asked_from[node] : asked_from[node + 1]]
        at = np.searchsorted(places, wanted[here])
        blocks[here] = inverse[at[:, :, None], at[:, None, :]]
    return blocks


def _supernodes(begin: IntArray, rows: IntArray) -> IntArray:
    """First columns of the supernodes, and the number of columns at the end."""
    counts = np.diff(begin)
    next_row = np.append(rows, -1)[begin[:-1]]  # of a column without any it is another's: then the counts do not fit
    follows = (counts[:-1] == counts[1:] + 1) & (next_row[:-1] == np.arange(1, len(counts)))
    return np.concatenate(([0], np.flatnonzero(~follows) + 1, [len(counts)]))


def _invert_front(numbers: FloatArray, pivots: FloatArray, inner: FloatArray) -> FloatArray:
    """Inverse on S and R, from the columns S of L, one after the other, the pivots D_S and the inverse Z_RR."""
    size = len(pivots)
    total = len(pivots) + len(inner)
    columns = np.eye(size, total)
    columns[np.arange(total) > np.arange(size)[:, None]] = numbers
    of_own = np.linalg.inv(columns[:, :size])  # L_SS^-T
    gain = columns[:, size:].T @ of_own.T
    inverse = np.empty((total, total))
    inverse[size:, size:] = inner
    inverse[size:, :size] = across = -inner @ gain
    inverse[:size, size:] = across.T
    inverse[:size, :size] = (of_own / pivots) @ of_own.T - gain.T @ across
    return inverse
