"""Pose graphs of which the truth is known: a robot walks about, sees where it was before, and some of it is false."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray
from support.relative_covariances import squared_innovations


@dataclass(frozen=True)
class KnownGraph:
    """A graph about the poses that its odometry tells, the true poses (N, 3), and which measurements are false (M,)."""

    graph: PoseGraph
    truth: FloatArray
    false: np.ndarray


def random_graph(
    rng: np.random.Generator, poses: int = 30, closures: int = 15, noise: float = 1.0, false: int = 0
) -> KnownGraph:
    """Walk at random; measure increments and pairs near each other with Gaussian errors of the covariances told.

    `noise` scales standard deviations of about 3 cm and 0.01 rad, correlated and other ones for each measurement.
    False closures measure any two poses as anywhere within some metres. Edges run both ways and may stand twice.
    """
    steps = np.column_stack((rng.uniform(0.5, 1.0, poses), rng.normal(0, 0.1, poses), rng.normal(0, 0.7, poses)))
    truth = np.array([rng.uniform((-5, -5, -3), (5, 5, 3))] * poses)
    for k in range(1, poses):
        truth[k] = compose(truth[k - 1], steps[k])
    away = np.linalg.norm(truth[:, None, :2] - truth[None, :, :2], axis=2)
    away[np.abs(np.subtract.outer(np.arange(poses), np.arange(poses))) < 2] = np.inf
    near = np.argsort(away, axis=None)[: min(4 * closures, int(np.isfinite(away).sum()))]
    pairs = np.stack(np.unravel_index(rng.choice(near, closures), away.shape), axis=1)
    wrong = rng.integers(0, poses, false)
    wrong = np.stack((wrong, (wrong + rng.integers(2, poses - 1, false)) % poses), axis=1)
    chain = np.stack((np.arange(poses - 1), np.arange(1, poses)), axis=1)
    edges = np.concatenate((chain, pairs, wrong))

    shape = rng.normal(0, 0.3, (len(edges), 3, 3)) + np.eye(3)
    spread = noise * np.array([0.03, 0.03, 0.01])[:, None] * shape  # covariance: spread spread'
    errors = (spread @ rng.normal(size=(len(edges), 3, 1)))[:, :, 0]
    z = compose(between(truth[edges[:, 0]], truth[edges[:, 1]]), errors)
    z[len(chain) + closures :] = rng.uniform((-3, -3, -3), (3, 3, 3), (false, 3))
    information = np.linalg.inv(spread @ spread.transpose(0, 2, 1)) if noise else np.tile(np.eye(3), (len(edges), 1, 1))
    information = 0.5 * (information + information.transpose(0, 2, 1))
    guess = truth.copy()
    for k in range(1, poses):
        guess[k] = compose(guess[k - 1], z[k - 1])
    is_false = np.arange(len(edges)) >= len(chain) + closures
    trusted = np.arange(len(edges)) < len(chain)
    return KnownGraph(PoseGraph.of(guess, edges, z, information, trusted), truth, is_false)


def with_false_closures(graph: PoseGraph, share: float, rng: np.random.Generator) -> tuple[PoseGraph, np.ndarray]:
    """Add closures between any poses of a solved graph that measure anything, and tell which are false.

    As many as a share of those there are. One that the graph could follow by chance is no false closure, so each is
    farther than seven standard deviations from what the graph predicts.
    """
    closures, poses = np.flatnonzero(~graph.trusted), len(graph.poses)
    count = round(share * len(closures))
    spare = count + count // 4 + 5
    first = rng.integers(0, poses, spare)
    edges = np.stack((first, (first + rng.integers(2, poses - 1, spare)) % poses), axis=1)
    z = np.column_stack((rng.normal(0, 1, (spare, 2)), rng.uniform(-np.pi, np.pi, spare)))
    information = graph.information[rng.choice(closures, spare)]
    wrong = np.flatnonzero(squared_innovations(graph, edges, z, information) > 49)[:count]
    more = PoseGraph.of(
        graph.poses,
        np.concatenate((graph.edges, edges[wrong])),
        np.concatenate((graph.measurements, z[wrong])),
        np.concatenate((graph.information, information[wrong])),
        np.concatenate((graph.trusted, np.zeros(count, np.bool_))),
    )
    return more, np.arange(len(more.edges)) >= len(graph.edges)
