"""Key scans are left out of a graph: poses stay, loops stay closed, and nothing is known better than before."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam.marginalization import marginalize
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph
from gridslam.slam.pose_graph.linear import linearize
from gridslam.slam.pose_graph.marginals import Marginals

COUNT = 60


def walk(seed, count=COUNT, begins=()):
    """A graph of a walk on a spiral, at its solution: no measurement pulls. Some key scans begin drives."""
    rng = np.random.default_rng(seed)
    graph = KeyGraph()
    pose = np.array([3.0, -2.0, 0.7])
    for key in range(count):
        covariance = np.diag(rng.uniform(0.5, 2.0, 3) * [1e-4, 2e-4, 1e-5])
        variances = (2e-4, 2e-5)
        if key in begins:
            variances, covariance = UNKNOWN_VARIANCES, np.diag(np.take(UNKNOWN_VARIANCES, [0, 0, 1]))
        graph.extend(pose, pose, variances, covariance)
        pose = compose(pose, np.array([0.4, 0.0, rng.uniform(0.1, 0.3)]))
    return graph


def close(graph, *pairs, source=ConstraintSource.RECOGNIZED, sigma=0.02):
    for from_, to in pairs:
        information = np.diag([1 / sigma**2, 0.5 / sigma**2, 4 / sigma**2])
        measured = between(graph.poses[from_], graph.poses[to])
        graph.add(Constraint(from_, to, measured, information, source, True))
    return graph


def pose_graph(graph):
    """As the final refinement has it, with the expected covariances of the increments."""
    found = graph.graph()
    information = found.information.copy()
    information[: len(graph) - 1] = np.linalg.inv(np.array(graph.covariances[1:]))
    return replace(found, information=information)


def information_of(graph, kept):
    """Information matrix of some poses, all others marginalized, dense."""
    count = len(graph.poses)
    blocks = linearize(graph, graph.poses, graph.errors())
    whole = np.zeros((count, 3, count, 3))
    for (a, b), first, cross, second in zip(graph.edges, blocks.first, blocks.cross, blocks.second, strict=True):
        whole[a, :, a] += first
        whole[b, :, b] += second
        whole[a, :, b] += cross
        whole[b, :, a] += cross.T
    own = (3 * np.asarray(kept)[:, None] + np.arange(3)).ravel()
    left = np.setdiff1d(np.arange(3 * count), own)
    matrix = whole.reshape(3 * count, -1)
    across = matrix[np.ix_(own, left)]
    known = matrix[np.ix_(own, own)]
    return known - across @ np.linalg.solve(matrix[np.ix_(left, left)], across.T)


def blocks(*numbers):
    return np.concatenate([np.arange(10 * number, 10 * number + 10) for number in numbers])


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_known_better_than_before(seed):
    """What the thinned graph knows of all its poses together is at most what the whole one does (Loewner's order)."""
    rng = np.random.default_rng(seed)
    pairs = {tuple(sorted(rng.choice(COUNT, 2, replace=False).tolist())) for _ in range(14)}
    graph = close(walk(seed), *(pair for pair in pairs if pair[1] - pair[0] > 3))
    close(graph, (5, 47), (12, 33), source=ConstraintSource.PROXIMITY)
    kept = blocks(0, 3, 5) if seed % 2 else blocks(1, 4)
    thinned = marginalize(graph, kept)
    known = information_of(pose_graph(graph), kept)
    left = information_of(pose_graph(thinned), np.arange(len(kept)))
    scale = np.sqrt(np.diag(known))
    assert np.linalg.eigvalsh((known - left) / np.outer(scale, scale)).min() > -1e-6
    assert len(thinned.constraints) > 0


def test_poses_and_what_was_tracked_between_key_scans_that_are_kept_stay():
    graph = walk(1)
    graph.tracked = list(compose(np.array([5.0, 5.0, 1.0]), np.array(graph.tracked) + 0.01))
    graph.frozen = 25
    kept = blocks(1, 2, 4)
    thinned = marginalize(graph, kept)
    assert np.array(thinned.poses).tobytes() == np.array(graph.poses)[kept].tobytes()
    assert thinned.frozen == 15
    before, after = np.array(graph.tracked)[kept], np.array(thinned.tracked)
    for part in (slice(0, 20), slice(20, 30)):
        expected = between(before[part][:-1], before[part][1:])
        np.testing.assert_allclose(between(after[part][:-1], after[part][1:]), expected, atol=1e-9)
    across = between(after[19], after[20])
    np.testing.assert_allclose(across, between(thinned.poses[19], thinned.poses[20]), atol=1e-9)


def test_a_loop_stays_closed_whose_key_scans_are_left_out():
    graph = close(walk(3), (4, 47))
    kept = blocks(1, 2, 3, 5)  # neither submap of the closure
    thinned = marginalize(graph, kept)
    ((from_, to),) = [c.pair for c in thinned.constraints]
    assert (kept[from_], kept[to]) == (10, 50)
    whole, left, chain = (
        np.trace(Marginals(pose_graph(g)).relative_covariances(a, b)[:2, :2])
        for g, a, b in (
            (graph, 10, 50),
            (thinned, from_, to),
            (marginalize(walk(3), kept), from_, to),
        )
    )
    assert whole <= left < 0.5 * chain
