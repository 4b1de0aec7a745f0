"""Checks of exercise 1: motion models."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


def samples_have_moments(
    sample: Callable[[FloatArray, Rng], FloatArray],
    before: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    wrong_means: Mapping[str, FloatArray] | None = None,
    wrong_covariances: Mapping[str, FloatArray] | None = None,
) -> None:
    """Of 100,000 successors of the pose `before` (3,): mean (3,), covariance (3, 3), headings in [-pi, pi).

    Standard error of a mean: spread / sqrt(n); of a covariance at most spread_i spread_j sqrt(2/n). Five of each hold
    with a chance of a failure below 1e-4 over all entries. Noise of 3 % of a radian leaves a second-order bias below
    (0.03)^2 m and a relative change of covariance below 2 * 0.03^2.
    """
    n = 100_000
    samples = sample(np.tile(before, (n, 1)), np.random.default_rng(7))
    require(samples.shape == (n, 3), f"expected successors of shape {(n, 3)}, got {samples.shape}")
    require(
        bool(((samples[:, 2] >= -math.pi) & (samples[:, 2] < math.pi)).all()),
        "a heading is not in [-pi, pi): wrap the sum of angles",
    )
    spread = np.sqrt(np.diag(covariance))
    tolerance = 5 * spread / math.sqrt(n) + 0.03**2
    errors = samples - mean
    errors[:, 2] = wrap(errors[:, 2])
    about = errors - errors.mean(axis=0)
    wide = np.outer(spread, spread) * (5 * math.sqrt(2 / n) + 2 * 0.03**2) + 1e-15
    wrong = {name: value - mean for name, value in (wrong_means or {}).items()}
    for value in wrong.values():
        value[2] = wrap(value[2])
    still_right = np.abs(errors.mean(axis=0)) <= tolerance
    if still_right.all() or not any(
        (np.abs(errors.mean(axis=0) - value) <= tolerance).all() for value in wrong.values()
    ):
        expect("covariance of the successors", about.T @ about / n, covariance, wide, wrong_covariances)
    expect("mean of the successors, less the expected one", errors.mean(axis=0), np.zeros(3), tolerance, wrong)


def _moments_of_odometry(variances: Sequence[float], jacobian: FloatArray, turn: FloatArray) -> FloatArray:
    return np.asarray(turn @ jacobian @ np.diag(variances) @ jacobian.T @ turn.T)


def odometry_motion(sample: Callable[[FloatArray, FloatArray, Sequence[float], Rng], FloatArray]) -> None:
    """Table 5.6, `sample(poses, increment, alphas, rng)`: increments whose moments are known by hand.

    1 m ahead: var(rot1) = var(rot2) = alpha2, var(trans) = alpha3, and y moves with rot1 by 1 m/rad. 1 m to the left:
    rot1 = -rot2 = pi/2, and x moves with rot1 by -1 m/rad. Half a radian on the spot: rot2 alone. 1 m to the left and
    0.4 rad: rot1 and rot2 differ.
    """
    alphas = a1, a2, a3, a4 = 1e-4, 2e-4, 3e-4, 4e-4
    before = np.array([3.0, -2.0, 3.0])  # heading near pi: samples fall on both sides of the seam
    c, s = math.cos(before[2]), math.sin(before[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for dx, dy, heading in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.5), (0.0, 1.0, 0.4)):
        moved = np.array([dx, dy, heading])
        trans, rot1 = math.hypot(dx, dy), math.atan2(dy, dx)
        rot2 = heading - rot1
        first, second = a1 * rot1**2 + a2 * trans**2, a1 * rot2**2 + a2 * trans**2
        along = a3 * trans**2 + a4 * (rot1**2 + rot2**2)
        by_rot1 = np.array([-dy, dx, 1.0])
        jacobian = np.column_stack([by_rot1, [math.cos(rot1), math.sin(rot1), 0.0], [0.0, 0.0, 1.0]])
        straight = np.column_stack([[0.0, 0.0, 1.0], jacobian[:, 1:].T[0], jacobian[:, 2]])
        unturned = np.column_stack([[-dy, dx, 0.0], jacobian[:, 1:].T[0], jacobian[:, 2]])
        variances = np.array([first, along, second])
        own = (
            "each pose needs noise of its own, with the square root of the variance: draw r1, s and r2 for all poses "
            "(size=len(poses))"
        )
        covariances = {
            "the variance of the second rotation follows from rot2, not from rot1": [first, along, first],
            own: [0.0, along, second],
            f"{own} ": [first, 0.0, second],
            f"{own}  ": [first, along, 0.0],
            f"{own}   ": [0.0, 0.0, 0.0],
            "alphas give variances, and rng.normal takes standard deviations: take the square root": variances**2,
            "the variance of the translation has the term alpha_4 (rot1^2 + rot2^2), too": (
                [first, a3 * trans**2, second]
            ),
            "the variance of the translation lacks alpha_3 trans^2": [first, a4 * (rot1**2 + rot2**2), second],
            "alpha_1 and alpha_2 are exchanged": ([a2 * rot1**2 + a1 * trans**2, along, a2 * rot2**2 + a1 * trans**2]),
            "alpha_3 and alpha_4 are exchanged": [first, a4 * trans**2 + a3 * (rot1**2 + rot2**2), second],
        }
        wrong = {name: _moments_of_odometry(np.asarray(v), jacobian, turn) for name, v in covariances.items()}
        wrong["the robot drives in the direction theta + r1, with r1 as sampled"] = _moments_of_odometry(
            variances, straight, turn
        )
        in_map = turn @ jacobian
        for axis, formula in enumerate(("x by s cos(theta + r1)", "y by s sin(theta + r1)")):
            unsampled = in_map.copy()
            unsampled[axis, 0] = 0.0
            wrong[f"the robot moves in {formula}, with r1 as sampled"] = _moments_of_odometry(
                variances, unsampled, np.eye(3)
            )
        wrong["the heading changes by r1 + r2, both as sampled"] = _moments_of_odometry(variances, unturned, turn)
        means = {
            "rot2 is the turn less rot1": compose(before, [dx, dy, heading + rot1]),
            "the increment is in the frame of the pose before: the robot drives in the direction theta + r1": (
                compose(before, [trans, 0.0, heading])
            ),
            "the increment is in the frame of the pose before, not in that of the map": before + moved,
            "math.atan2 takes y first, then x": compose(before, [dy, dx, heading]),
            "the heading changes by r1 + r2": compose(before, [dx, dy, rot2]),
        }

        def drawn(poses: FloatArray, rng: Rng, moved: FloatArray = moved) -> FloatArray:
            return sample(poses, moved, alphas, rng)

        covariance = _moments_of_odometry(variances, jacobian, turn)
        samples_have_moments(drawn, before, compose(before, moved), covariance, means, wrong)
