"""Marginal covariances of a solved pose graph, without inverting its information matrix."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between, between_jacobians
from gridslam.slam.pose_graph.linear import BlockSystem, linearize, require_connected
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

_SOLUTIONS_PER_POSE = 0.1
"""Columns of the inverse that cost as much to solve for as all blocks on its diagonal, for each pose."""


def marginal_covariances(graph: PoseGraph) -> FloatArray:
    """Covariances (N, 3, 3) in m^2, m rad and rad^2 of all poses, map frame; 0 for what is held. See `Marginals`."""
    return _covariances(len(graph.poses), Marginals(graph).factors())  # with the factors alone in memory


@final
class Marginals:
    """The normal distribution about the poses of a graph (Laplace's approximation), its information factorized.

    Parameters
    ----------
    graph : PoseGraph
        Solved; for a robust solution `GraphSolution.weighted_graph`. Covariances are of the coordinates x, y and theta
        in the map frame, given the poses that are held, and right as far as the information matrices of the
        measurements are.

    Raises
    ------
    ArgumentError
        The measurements do not join all poses.
    """

    def __init__(self, graph: PoseGraph) -> None:
        require_connected(graph.edges, len(graph.poses))
        self._poses = graph.poses
        self._held = graph.held
        if len(graph.poses) > graph.held:
            self._system = BlockSystem(graph.edges, len(graph.poses), 3, graph.held)
            self._system.factorize(self._system.assemble(linearize(graph, graph.poses, graph.errors()))[0])

    @cached_property
    def covariances(self) -> FloatArray:
        """Covariances (N, 3, 3) of all poses, by the blocks of the inverse that the factor's pattern holds."""
        return _covariances(len(self._poses), self.factors())

    def factors(self) -> tuple[Any, ...]:
        """Return the factors of the information (see `BlockSystem.factors`); none where all poses are held."""
        return self._system.factors() if len(self._poses) > self._held else ()

    def covariances_with(self, pose: int) -> FloatArray:
        """Covariances (N, 3, 3) of every pose (rows) with one (columns): three columns of the inverse."""
        self._check(pose)
        columns = np.zeros((len(self._poses), 3, 3))
        for k in range(3 if pose >= self._held else 0):
            unit = np.zeros(3 * (len(self._poses) - self._held))
            unit[3 * (pose - self._held) + k] = 1.0
            columns[:, :, k] = self._system.solve(unit)
        return columns

    def relative_covariances(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Covariances (..., 3, 3) of poses `second` (...) seen from poses `first` (...), in the frame of `first`.

        Both broadcast; each different pose among `first` costs three columns of the inverse.

        Raises
        ------
        ArgumentError
            There is no such pose.
        """
        a, b = np.broadcast_arrays(np.asarray(first, np.int64), np.asarray(second, np.int64))
        for pose in np.unique(b).tolist():
            self._check(pose)
        cross = np.empty((*a.shape, 3, 3))
        for pose in np.unique(a).tolist():
            cross[a == pose] = self.covariances_with(pose)[b[a == pose]]
        of_first, of_second = between_jacobians(self._poses[a], self._poses[b])
        mixed = of_first @ cross.swapaxes(-1, -2) @ of_second.swapaxes(-1, -2)
        sides = (j @ self._of(at) @ j.swapaxes(-1, -2) for j, at in ((of_first, a), (of_second, b)))
        return np.asarray(sum(sides, mixed + mixed.swapaxes(-1, -2)))

    def squared_innovations(self, edges: IntArray, measurements: FloatArray, information: FloatArray) -> FloatArray:
        """Squared Mahalanobis distances (K,) of measurements that are not in the graph from what the graph predicts.

        e' (C + information^-1)^-1 e with C the covariance of the prediction: to first order what chi2 would grow by if
        the measurement were added and followed; for a true one distributed as chi2 with three degrees of freedom.

        Parameters
        ----------
        edges, measurements, information : (K, 2) int64, (K, 3) and (K, 3, 3) float64
            As in `PoseGraph`.
        """
        predicted = between(self._poses[edges[:, 0]], self._poses[edges[:, 1]])
        errors = between(measurements, predicted)[:, :, None]
        _, turn = between_jacobians(measurements, predicted)
        spread = turn @ self.relative_covariances(*edges.T) @ turn.transpose(0, 2, 1) + np.linalg.inv(information)
        return np.asarray((errors * np.linalg.solve(spread, errors)).sum(axis=(1, 2)))

    def _of(self, poses: IntArray) -> FloatArray:
        """Covariances (..., 3, 3) of some poses (...), by the cheaper way."""
        some, place = np.unique(poses, return_inverse=True)
        if "covariances" in self.__dict__ or 3 * len(some) > _SOLUTIONS_PER_POSE * len(self._poses):
            return self.covariances[poses]
        own = np.array([self.covariances_with(pose)[pose] for pose in some.tolist()])
        return own[place.reshape(poses.shape)]

    def _check(self, pose: int) -> None:
        if not 0 <= pose < len(self._poses):
            raise ArgumentError("pose", f"a place in [0, {len(self._poses)})", pose)


def _covariances(poses: int, factors: tuple[Any, ...]) -> FloatArray:
    """Covariances (N, 3, 3) of N poses, of which the first are held and the others have these factors."""
    blocks = np.zeros((poses, 3, 3))
    if factors:
        lower, pivots, order = factors
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        blocks[poses - len(order) // 3 :] = _selected_inverse(lower, np.asarray(pivots), place.reshape(-1, 3))
    return blocks


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
