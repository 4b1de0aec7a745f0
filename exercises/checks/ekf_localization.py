"""Checks of exercise 4: EKF localization."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


def differences(function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-6) -> FloatArray:
    """Central finite differences (n, N) of a function of (N,)."""
    columns = []
    for k in range(len(at)):
        ahead, behind = (np.array(at, float) for _ in range(2))
        ahead[k] += step
        behind[k] -= step
        columns.append((function(ahead) - function(behind)) / (2 * step))
    return np.stack(columns, axis=1)


Gaussian = tuple[FloatArray, FloatArray]
"""Mean (3,) and covariance (3, 3) of a pose."""


def prediction_is_linearized(predict: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], Gaussian]) -> None:
    """`predict(mean, P, increment, M)`: the mean moves, and P is carried by the Jacobians of `compose`."""
    rng = np.random.default_rng(0)
    for k in range(10):
        mean = np.array([*rng.normal(0, 3, 2), rng.uniform(-3, 3)])
        increment = rng.normal(0, 0.5, 3)
        if k == 0:
            mean[2], increment[2] = 3.0, 0.4  # across pi
        P = random_covariance(rng, 0.2)
        M = random_covariance(rng, 0.05)
        G = differences(lambda x: compose(x, increment), mean)  # noqa: B023
        V = differences(lambda u: compose(mean, u), increment)  # noqa: B023
        moved, covariance = predict(mean, P, increment, M)
        right = compose(mean, increment)
        unwrapped = np.array([*right[:2], mean[2] + increment[2]])
        require(np.shape(moved) == (3,), f"mean: expected shape (3,), got {np.shape(moved)}")
        means = {
            "the increment is in the frame of the robot: turn it by the heading (`compose`)": (
                np.array([*(mean + increment)[:2], right[2]])
            ),
            "the increment is turned by the old heading, not by the new one": (
                np.array([*compose([*mean[:2], unwrapped[2]], [*increment[:2], 0.0])[:2], right[2]])
            ),
            "the increment is turned the wrong way: [[cos, -sin], [sin, cos]]": (
                np.array([*compose([*mean[:2], -mean[2]], [*increment[:2], 0.0])[:2], right[2]])
            ),
            "the heading changes by that of the increment": np.array([*right[:2], mean[2]]),
        }
        expect("mean after the prediction", [*moved[:2], wrap(moved[2])], right, 1e-9, means)
        require(-math.pi <= moved[2] <= math.pi, "mean: the heading is not in [-pi, pi): wrap it")
        off = np.eye(3)
        off[:2, 2] = -G[:2, 2]
        swapped = np.eye(3)
        swapped[:2, 2] = G[1::-1, 2]
        late = differences(lambda x: compose([*x[:2], x[2] + increment[2]], increment), mean)  # noqa: B023
        covariances = {
            "the derivatives by the heading in G have the wrong sign": off @ P @ off.T + V @ M @ V.T,
            "the derivatives by the heading in G are exchanged": swapped @ P @ swapped.T + V @ M @ V.T,
            "the derivatives by the heading are taken at the heading before the motion": late @ P @ late.T
            + V @ M @ V.T,
            "G has the derivatives by the heading: an error of the heading moves the robot": P + V @ M @ V.T,
            "the noise is in the frame of the robot: V M V'": G @ P @ G.T + M,
            "the noise is turned the wrong way: V M V', not V' M V": G @ P @ G.T + V.T @ M @ V,
            "add the noise of the motion": G @ P @ G.T,
            "the covariance is transformed on both sides: G P G'": G @ P + V @ M @ V.T,
            "G P G', not G' P G": G.T @ P @ G + V @ M @ V.T,
        }
        expect("covariance after the prediction", covariance, G @ P @ G.T + V @ M @ V.T, 1e-8, covariances)


def range_and_bearing(pose: FloatArray, landmark: FloatArray) -> FloatArray:
    """[range m, bearing rad] of a landmark (2,) from a pose (3,), without noise."""
    dx, dy = landmark - pose[:2]
    return np.array([math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose[2], math.tau)])


def correction_is_linearized(
    correct: Callable[[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray], Gaussian],
) -> None:
    """`correct(mean, P, z, landmark, Q)`: the Kalman filter's with the numerical Jacobian, also behind the robot."""
    rng = np.random.default_rng(1)
    Q = np.diag([0.01, 0.0004])
    landmark = np.array([1.0, 2.0])
    for bearing in 4 * (0.3, -1.2, math.pi - 0.001, -math.pi + 0.001):
        heading = rng.uniform(-3, 3)
        direction = bearing + heading
        mean = np.array([*(landmark - 3 * np.array([math.cos(direction), math.sin(direction)])), heading])
        P = random_covariance(rng, 0.1)
        offset = np.array([0.05, math.copysign(0.01, bearing)])  # a bearing beyond pi comes round
        expected = range_and_bearing(mean, landmark)
        z = expected + offset
        z[1] = math.remainder(z[1], math.tau)
        H = differences(lambda x: unwrapped(range_and_bearing(x, landmark), expected), mean)  # noqa: B023
        K = kalman_gain(P, H, Q)
        corrected, covariance = correct(mean, P, z, landmark, Q)
        require(np.shape(corrected) == (3,), f"mean: expected shape (3,), got {np.shape(corrected)}")
        dx, dy = landmark - mean[:2]
        raw = z - [expected[0], math.atan2(dy, dx) - mean[2]]
        wrong, wrong_covariances = wrong_corrections(P, H, Q, offset, raw)
        away = [offset[0], math.remainder(z[1] + expected[1], math.tau)]
        wrong["your bearing has the opposite sign: it is atan2(dy, dx) less the heading"] = K @ away
        turned = [offset[0], math.remainder(z[1] - math.atan2(dx, dy) + mean[2], math.tau)]
        wrong["math.atan2 takes y first, then x"] = K @ turned
        absolute = [offset[0], math.remainder(z[1] - math.atan2(dy, dx), math.tau)]
        wrong["the bearing is seen from the robot: subtract its heading"] = K @ absolute
        expect("change of the mean", corrected - mean, K @ offset, 1e-7, wrong)
        expect("covariance after the correction", covariance, (np.eye(3) - K @ H) @ P, 1e-7, wrong_covariances)


def kalman_gain(P: FloatArray, H: FloatArray, Q: FloatArray) -> FloatArray:
    """Return the Kalman gain of a covariance P, a Jacobian H and noise Q."""
    return np.asarray(P @ H.T @ np.linalg.inv(H @ P @ H.T + Q))


def wrong_corrections(
    P: FloatArray, H: FloatArray, Q: FloatArray, innovation: FloatArray, raw: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return changes of a mean, and covariances, of typical mistakes; `raw` is the innovation with unwrapped angles."""
    K = kalman_gain(P, H, Q)
    one = np.eye(len(P))
    noiseless = P @ H.T @ np.linalg.pinv(H @ P @ H.T)
    changes = {
        "differences of angles must be wrapped to [-pi, pi)": K @ raw,
        "the innovation is the measurement less the prediction, z - h": -K @ innovation,
        "the noise Q of the observation belongs in S": noiseless @ innovation,
        "the derivatives of the range have the wrong sign": kalman_gain(P, H * [[-1.0], [1.0]], Q) @ innovation,
        "the derivatives of the bearing have the wrong sign": kalman_gain(P, H * [[1.0], [-1.0]], Q) @ innovation,
        "the mean changes by K times the innovation": np.zeros(len(P)),
        "K has the inverse of S": P @ H.T @ (H @ P @ H.T + Q) @ innovation,
    }
    if len(P) == 3:
        still = H.copy()
        still[:, 2] = 0.0
        changes["the bearing has a derivative by the robot's heading: -1"] = kalman_gain(P, still, Q) @ innovation
    else:
        alone = np.zeros(len(P))
        alone[:3] = (K @ innovation)[:3]
        changes["an observation corrects all of the state, by its covariances: not the pose alone"] = alone
    covariances = {
        "the covariance shrinks: (I - K H) P": P,
        "(I - K H) P, with a minus sign": (one + K @ H) @ P,
        "the noise Q of the observation belongs in S": (one - noiseless @ H) @ P,
        "I - K H is multiplied with P": one - K @ H,
    }
    return changes, covariances


def unwrapped(z: FloatArray, near: FloatArray) -> FloatArray:
    """Return a measurement with its bearing within half a turn of another one."""
    return np.array([z[0], near[1] + math.remainder(z[1] - near[1], math.tau)])


def random_covariance(rng: Rng, sigma: float) -> FloatArray:
    """Return a covariance with entries of about sigma squared."""
    root = sigma * (np.eye(3) + 0.4 * rng.normal(size=(3, 3)))
    return np.asarray(root @ root.T)
