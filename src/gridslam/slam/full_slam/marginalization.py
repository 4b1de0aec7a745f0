"""Marginalize key scans out of a key graph: their information is kept as far as none is counted twice."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import adjoint, between, compose
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph, submap_of
from gridslam.types import FloatArray, IntArray


def marginalize(graph: KeyGraph, kept: IntArray) -> KeyGraph:
    """Make the graph of the key scans `kept` (K,), ascending, about the same poses.

    Increments that follow one another become one, its covariance the sum of theirs. A closure of a key scan that is
    left out is carried along the increments to the nearest one that is kept; of several between two submaps the most
    certain one is. Where increments lead to a closure and onward, too, their information is divided: one half leads
    onward, the other half to the closures, each its share. That is the graph with copies of the poses between, free of
    each other, where the whole graph has them agree: its chi2 is nowhere greater, so it never knows more. Of the other
    constraints those between key scans that are kept are; the final refinement matches what lies near each other again.

    What is made of several measurements is as the poses have it: at these no measurement pulls, so that the most likely
    poses stay what they are.

    Returns
    -------
    KeyGraph
        Numbered from 0; what was frozen is.

    References
    ----------
    The exact marginal is dense. Kretzschmar, Stachniss, Information-theoretic compression of pose graphs for
    laser-based SLAM (2012), keep a tree of it; Carlevaris-Bianco, Kaess, Eustice, Generic node removal for
    factor-graph SLAM (2014), require that an approximation is conservative, as here.
    """
    chain = _Chain(graph, kept)
    carried = chain.select_closures()
    users = Counter(step for closure in carried for way in (closure.from_, closure.to) for step in way.steps)
    thinned = KeyGraph()
    for place, key in enumerate(kept.tolist()):
        before = int(kept[place - 1]) if place else key - 1
        if before == key - 1:
            first = key if place else 0
            step = _Step(
                between(graph.tracked[before], graph.tracked[key]),
                graph.variances[first],
                graph.covariances[first],
                graph.drift_covariances[first],
            )
        else:
            step = chain.join(before, key, users)
        tracked = compose(thinned.tracked[-1], step.moved) if place else graph.tracked[key]
        moved = step.variances, step.covariance, step.drift_covariance
        thinned.extend(tracked, graph.poses[key], *moved, graph.odometry[key])
    number = {key: place for place, key in enumerate(kept.tolist())}
    thinned.constraints = [
        c._replace(from_=number[c.from_], to=number[c.to])
        for c in graph.constraints
        if c.from_ in number and c.to in number
    ]
    thinned.constraints += [chain.carry(closure, users, number) for closure in carried]
    thinned.frozen = int(np.searchsorted(kept, graph.frozen))
    thinned.correct(np.array(thinned.poses).reshape(-1, 3))
    return thinned


@final
class _Step(NamedTuple):
    """An increment: as it was tracked, and as uncertain as a `KeyGraph` has it."""

    moved: FloatArray
    variances: tuple[float, float]
    covariance: FloatArray
    drift_covariance: FloatArray


@final
class _Way(NamedTuple):
    """From a key scan that is kept to one that is not, or to itself: the increments between, by where they end."""

    hub: int
    key: int
    steps: tuple[int, ...]


@final
class _Closure(NamedTuple):
    """A closure, and the paths that lead to it."""

    constraint: Constraint
    from_: _Way
    to: _Way


@final
class _Chain:
    """The increments of a graph, some key scans of which are kept."""

    def __init__(self, graph: KeyGraph, kept: IntArray) -> None:
        self._graph = graph
        self._kept = kept
        self._labels = graph.label_gaps()
        self._poses = np.array(graph.poses)

    def select_closures(self) -> list[_Closure]:
        """Closures of key scans that are left out, the most certain one between each two submaps that have none."""
        kept = set(self._kept.tolist())
        known = set()
        found: dict[tuple[int, int], tuple[float, _Closure]] = {}
        for constraint in self._graph.constraints:
            if not constraint.determined or constraint.source is ConstraintSource.PROXIMITY:
                continue
            from_, to = self._find_way(constraint.from_), self._find_way(constraint.to)
            if from_ is None or to is None:
                continue
            closure = _Closure(constraint, from_, to)
            pair = _submaps(closure)
            if kept.issuperset(constraint.pair):
                known.add(pair)
                continue
            spread = float(np.trace(self._spread(closure, Counter())[:2, :2]))
            if pair[0] != pair[1] and (pair not in found or spread < found[pair][0]):
                found[pair] = spread, closure
        return [closure for pair, (_, closure) in sorted(found.items()) if pair not in known]

    def _find_way(self, key: int) -> _Way | None:
        """The shorter way to a key scan from one that is kept, without a gap; None if there is none."""
        at = int(np.searchsorted(self._kept, key))
        near = self._kept[max(at - 1, 0) : at + 1].tolist()
        hubs = [hub for hub in near if self._labels[hub] == self._labels[key]]
        if not hubs:
            return None
        hub = min(hubs, key=lambda hub: abs(hub - key))
        return _Way(hub, key, tuple(range(min(hub, key) + 1, max(hub, key) + 1)))

    def join(self, first: int, last: int, users: Counter[int]) -> _Step:
        """The increments from a key scan to a later one as one."""
        graph = self._graph
        moved = between(graph.poses[first], graph.poses[last])
        steps = range(first + 1, last + 1)
        if any(graph.begins_drive(step) for step in steps):
            unknown = np.diag(np.take(UNKNOWN_VARIANCES, [0, 0, 1]))
            return _Step(moved, UNKNOWN_VARIANCES, unknown, unknown)
        share = {step: 2.0 if users[step] else 1.0 for step in steps}
        bounds = self._sum({k: share[k] * np.diag(np.take(graph.variances[k], [0, 0, 1])) for k in steps}, last)
        expected = self._sum({k: share[k] * graph.covariances[k] for k in steps}, last)
        drift = self._sum({k: share[k] * graph.drift_covariances[k] for k in steps}, last)
        widest = float(np.linalg.eigvalsh(bounds[:2, :2])[-1])
        return _Step(moved, (widest, float(bounds[2, 2])), expected, drift)

    def carry(self, closure: _Closure, users: Counter[int], number: dict[int, int]) -> Constraint:
        """The closure between the key scans that are kept."""
        spread = self._spread(closure, users)
        from_, to = closure.from_.hub, closure.to.hub
        if from_ > to:
            turn = adjoint(between(self._poses[from_], self._poses[to]))
            spread = turn @ spread @ turn.T
            from_, to = to, from_
        information = np.linalg.inv(spread)
        return closure.constraint._replace(
            from_=number[from_],
            to=number[to],
            measurement=between(self._poses[from_], self._poses[to]),
            information=0.5 * (information + information.T),
        )

    def _spread(self, closure: _Closure, users: Counter[int]) -> FloatArray:
        """Covariance (3, 3) of a closure with the ways to it, in the frame of the hub that it leads to."""
        hub = closure.to.hub
        covariances = self._graph.covariances
        ways = [self._sum({k: 2.0 * max(users[k], 1) * covariances[k] for k in way.steps}, hub) for way in closure[1:]]
        measured = np.asarray(np.linalg.inv(closure.constraint.information), np.float64)
        own = self._sum({closure.constraint.to: measured}, hub)
        return np.asarray(sum(ways, own), np.float64)

    def _sum(self, covariances: dict[int, FloatArray], last: int) -> FloatArray:
        """Sum covariances (3, 3), each in the frame of its key scan, in that of another one."""
        keys = list(covariances)
        if not keys:
            return np.zeros((3, 3))
        turn = adjoint(between(self._poses[last], self._poses[keys]))
        return np.asarray((turn @ np.array(list(covariances.values())) @ turn.transpose(0, 2, 1)).sum(axis=0))


def _submaps(closure: _Closure) -> tuple[int, int]:
    """The submaps of the key scans by which a closure is kept."""
    a, b = sorted(submap_of(hub) for hub in (closure.from_.hub, closure.to.hub))
    return a, b
