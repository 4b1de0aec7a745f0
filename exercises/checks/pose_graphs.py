"""Checks of exercise 9: pose graphs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from checks.ekf_localization import differences
from gridslam import PoseGraph
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


def ring_graph(rng: Rng, noise: float = 1.0) -> tuple[PoseGraph, FloatArray]:
    """Return a drive twice around a ring of 15 places with closures between the rounds, and its true poses (30, 3).

    `noise` scales standard deviations of 3 cm and 0.01 rad. The graph's poses are those of dead reckoning.
    """
    headings = math.tau * np.arange(30) / 15
    truth = np.column_stack([3 * np.sin(headings), 3 - 3 * np.cos(headings), wrap(headings)])
    edges = np.array([[k, k + 1] for k in range(29)] + [[k, k + 15] for k in range(0, 15, 2)])
    sigma = np.array([0.03, 0.03, 0.01])
    exact = between(truth[edges[:, 0]], truth[edges[:, 1]])
    z = compose(exact, noise * sigma * rng.standard_normal(exact.shape))
    guess = [truth[0]]
    for increment in z[:29]:
        guess.append(compose(guess[-1], increment))
    information = np.tile(np.diag(sigma**-2), (len(edges), 1, 1))
    return PoseGraph.of(np.array(guess), edges, z, information), truth


def is_a_minimum(graph: PoseGraph, poses: FloatArray, rng: Rng) -> None:
    """No small step from `poses` lowers chi2; slope against curvature. Pose 0 stays where it is."""
    chi2 = graph.chi2(poses)
    for _ in range(20):
        step = rng.normal(size=poses.shape)
        step[0] = 0.0
        up, down = (graph.chi2(poses + sign * 1e-4 * step) for sign in (1, -1))
        message = "chi2 is not at its minimum: the information matrices belong in both H and b, and steps are repeated"
        require(min(up, down) > chi2, message)
        require(abs(up - down) < 1e-3 * (up + down - 2 * chi2), message)


def edge_jacobians(
    linearize: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
) -> None:
    """`linearize(x_i, x_j, z)` -> e (3,), A and B (3, 3): e = z^-1 (x_i^-1 x_j), against finite differences."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        x_i, x_j, z = rng.normal(0, 1, (3, 3))
        right = between(z, between(x_i, x_j))
        e, A, B = linearize(x_i, x_j, z)
        plain = x_j - x_i - z
        expect(
            "error of an edge",
            e,
            right,
            1e-9,
            {
                "differences of angles must be wrapped to [-pi, pi)": [*right[:2], plain[2]],
                "the error is in the frame of the measurement: z^-1 (x_i^-1 x_j)": between(x_i, x_j) - z,
                "the error is in the frame of the measurement: poses are not subtracted component by component": plain,
                "the error has the opposite sign": -right,
                "x_j is seen from x_i, not x_i from x_j": between(z, between(x_j, x_i)),
                "the error is z^-1 (x_i^-1 x_j), not its inverse": between(between(x_i, x_j), z),
            },
        )
        exact_A = differences(_error_by(x_i, x_j, z, 0), x_i)
        exact_B = differences(_error_by(x_i, x_j, z, 1), x_j)
        straight, flipped, sign = exact_A.copy(), exact_A.copy(), exact_A.copy()
        straight[:2, 2] = 0.0
        flipped[:2, 2] *= -1
        sign[2, 2] *= -1
        without = differences(_error_by(x_i, x_j, np.array([*z[:2], 0.0]), 1), x_j)
        blocks = {
            "a turn of x_i moves x_j as seen from it: the third column is missing": straight,
            "a turn of x_i moves x_j the other way: the signs of the third column are wrong": flipped,
            "the heading of x_i is subtracted: -1": sign,
            "x_i has the opposite sign of x_j": -exact_A,
            "A is the derivative by x_i, and B that by x_j: they are exchanged": exact_B,
            "the rotation of the measurement belongs to the derivative, (R_i R_z)'": np.asarray(
                differences(_error_by(x_i, x_j, np.array([*z[:2], 0.0]), 0), x_i)
            ),
        }
        mixed = exact_A.copy()
        mixed[:2, :2] = -without[:2, :2]
        blocks["the rotation of the measurement belongs to the derivative, (R_i R_z)' "] = mixed
        late = exact_A.copy()
        late[:2] = differences(_error_by(x_i, x_j, np.array([*z[:2], 0.0]), 0), x_i)[:2]
        blocks["the rotation of the measurement belongs to the derivative, (R_i R_z)'  "] = late
        turned = exact_A.copy()
        turned[:2, :2] = exact_A[:2, :2].T
        blocks["the rotation is the wrong way: (R_i R_z) transposed"] = turned.copy()
        turned[:2, 2] = turned[:2, :2] @ turned[:2, :2] @ exact_A[:2, 2]
        blocks["the rotation is the wrong way: (R_i R_z) transposed "] = turned
        same = -exact_A
        same[:2, 2] = exact_A[:2, 2]
        blocks["x_i has the opposite sign of x_j "] = same
        expect("A, the derivative by x_i", A, exact_A, 1e-7, blocks)
        expect(
            "B, the derivative by x_j",
            B,
            exact_B,
            1e-7,
            {
                "x_j is turned by (R_i R_z)'": np.eye(3),
                "the rotation of the measurement belongs to the derivative, (R_i R_z)'": without,
                "x_j has the opposite sign of x_i": -exact_B,
                "A is the derivative by x_i, and B that by x_j: they are exchanged": exact_A,
                "the rotation is the wrong way: (R_i R_z) transposed": exact_B.T,
            },
        )


def _error_by(x_i: FloatArray, x_j: FloatArray, z: FloatArray, which: int) -> Callable[[FloatArray], FloatArray]:
    """Error of an edge as a function of one of its poses, its heading near that at these."""
    at = between(z, between(x_i, x_j))[2]

    def error(x: FloatArray) -> FloatArray:
        e = between(z, between(*((x, x_j) if which == 0 else (x_i, x))))
        return np.array([*e[:2], at + math.remainder(e[2] - at, math.tau)])

    return error


def _solved(solve: Callable[[PoseGraph], FloatArray], graph: PoseGraph) -> FloatArray:
    before = graph.poses.copy()
    try:
        with np.errstate(all="ignore"):  # steps that diverge
            poses = np.asarray(solve(graph), np.float64)
    except np.linalg.LinAlgError:
        raise AssertionError("H is singular: hold pose 0, and leave its rows and columns out") from None
    require(poses.shape == before.shape, f"expected poses of shape {before.shape}, got {poses.shape}")
    require(bool((graph.poses == before).all()), "the poses of the graph were changed: work with a copy")
    require(bool(np.isfinite(poses).all()), "a pose is not finite: the steps diverge; each solves H step = -b")
    moved = np.abs(poses[0] - before[0]).max()
    require(moved == 0, f"pose 0 has moved by {moved:.3g}: H is singular unless it stays where it is")
    return poses


def graph_solver(solve: Callable[[PoseGraph], FloatArray]) -> None:
    """`solve(graph)` -> poses (N, 3): the truth without noise, otherwise a minimum of chi2 at which pose 0 is held."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        exact, truth = ring_graph(rng, noise=0.0)
        displaced = exact.with_poses(truth + np.r_[np.zeros((1, 3)), rng.normal(0, 0.05, (29, 3))])
        equal = PoseGraph.of(
            displaced.poses, exact.edges, exact.measurements, np.tile(np.eye(3), (len(exact.edges), 1, 1))
        )
        for graph in (equal, displaced):
            poses = _solved(solve, graph)
            before, after = graph.chi2(graph.poses), graph.chi2(poses)
            off = np.abs(between(truth, poses)).max()
            if off > 1e-6:
                if graph is displaced:
                    why = "the information matrices belong in both H and b"
                elif after > before:
                    why = (
                        "chi2 has grown: the step solves H step = -b, and is added; H is singular unless the rows and "
                        "columns of pose 0 are left out"
                    )
                else:
                    why = "repeat until the step is small: errors are not linear"
                raise AssertionError(f"a graph without noise: poses are {off:.2g} m or rad off; {why}")
        far = exact.with_poses(truth + [0.0, 0.0, math.tau] * np.r_[0.0, np.ones(29)][:, None])
        headings = _solved(solve, far)[:, 2]
        require(bool((np.abs(headings) <= math.pi).all()), "a heading is not in [-pi, pi): wrap it after each step")
        graph, truth = ring_graph(rng)
        poses = _solved(solve, graph)
        is_a_minimum(graph, poses, rng)
