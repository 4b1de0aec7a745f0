"""Checks of exercise 7: EKF SLAM."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from checks.ekf_localization import (
    differences,
    kalman_gain,
    prediction_is_linearized,
    random_covariance,
    range_and_bearing,
    unwrapped,
    wrong_corrections,
)
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.models.landmark import LandmarkModel, RangeBearing, RelativePosition

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


class LandmarkMeasurements(NamedTuple):
    """What EKF SLAM and FastSLAM get in one step: control, its noise, landmarks by name and their measurements."""

    increment: FloatArray
    noise: FloatArray  # covariance (3, 3) of the increment
    names: list[int]
    z: FloatArray


SlamRun = Callable[[LandmarkModel, Sequence[LandmarkMeasurements]], tuple[FloatArray, FloatArray]]
"""Sensor and steps to the mean (3 + 2 L,) and covariance of pose and landmarks, in the order of first observation."""


Slam = tuple[FloatArray, FloatArray]
"""Mean (3 + 2 L,) and covariance of pose and landmarks."""


def _slam_state(rng: Rng, landmarks: int = 2) -> Slam:
    size = 3 + 2 * landmarks
    mean = np.concatenate([[0.4, -0.3, 2.5], rng.normal(0, 3, 2 * landmarks)])
    root = 0.1 * (np.eye(size) + 0.4 * rng.normal(size=(size, size)))
    return mean, np.asarray(root @ root.T)


def slam_prediction(predict: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], Slam]) -> None:
    """`predict(mean, P, increment, noise)`: as without landmarks, whose correlations with the pose change, too."""
    prediction_is_linearized(predict)
    rng = np.random.default_rng(5)
    mean, P = _slam_state(rng)
    increment, noise = np.array([0.6, 0.1, 0.9]), random_covariance(rng, 0.05)
    F, V = np.eye(7), np.zeros((7, 3))
    F[:3, :3] = differences(lambda x: compose(x, increment), mean[:3])
    V[:3] = differences(lambda u: compose(mean[:3], u), increment)
    right = F @ P @ F.T + V @ noise @ V.T
    pose_only = P.copy()
    pose_only[:3, :3] = right[:3, :3]
    everywhere = F @ P @ F.T
    everywhere[:2, :2] += (V @ noise @ V.T)[:2, :2]
    moved, covariance = predict(mean, P, increment, noise)
    expect("landmarks after the prediction", np.asarray(moved)[3:], mean[3:], 1e-12)
    wrong = {
        "the covariances between pose and landmarks change by the motion, too: F P F', of the whole state": pose_only,
        "the noise of the heading is missing": everywhere,
    }
    expect("covariance after the prediction", covariance, right, 1e-7, wrong)


def landmark_is_added(add: Callable[[FloatArray, FloatArray, LandmarkModel, FloatArray, FloatArray], Slam]) -> None:
    """`add(mean, P, sensor, z, Q)`: the landmark and its covariances, with numerical derivatives of h^-1."""
    rng = np.random.default_rng(6)
    sensor = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
    mean, P = _slam_state(rng, 1)
    z, Q = np.array([3.0, 0.7]), np.diag([0.01, 0.0004])
    landmark = sensor.locate(mean[:3], z)
    A = differences(lambda x: sensor.locate(x, z), mean[:3])
    B = differences(lambda seen: sensor.locate(mean[:3], seen), z)
    across, own = A @ P[:3], A @ P[:3, :3] @ A.T + B @ Q @ B.T

    def joined(across: FloatArray, own: FloatArray) -> FloatArray:
        return np.block([[P, across.T], [across, own]])

    found, covariance = add(mean, P, sensor, z, Q)
    c, s = math.cos(z[1]), math.sin(z[1])
    expect(
        "mean with the new landmark",
        found,
        np.concatenate([mean, landmark]),
        1e-9,
        {
            "the landmark is where `sensor.locate` puts it from the pose, in the map frame": (
                np.concatenate([mean, 3.0 * np.array([c, s])])
            ),
            "the landmark belongs to the end of the state": np.concatenate([landmark, mean]),
        },
    )
    wrong = {
        "the new landmark is correlated with all of the state: P_my = A P_xy": joined(0 * across, own),
        "the correlation with the state has the wrong sign: A = - H_m^-1 H_x": joined(-across, own),
        "the noise of the observation is in its own units: H_m^-1 Q H_m^-T": joined(across, A @ P[:3, :3] @ A.T + Q),
        "add the noise of the observation": joined(across, A @ P[:3, :3] @ A.T),
        "add the uncertainty of the pose, A P_xx A'": joined(across, B @ Q @ B.T),
        "the noise is turned the wrong way: H_m^-1 Q H_m^-T": joined(across, A @ P[:3, :3] @ A.T + B.T @ Q @ B),
        "the new landmark is correlated with the other landmarks, too": joined(
            np.hstack([across[:, :3], np.zeros((2, 2))]), own
        ),
    }
    expect("covariance with the new landmark", covariance, joined(across, own), 1e-7, wrong)


def slam_correction(
    correct: Callable[[FloatArray, FloatArray, LandmarkModel, int, FloatArray, FloatArray], Slam],
) -> None:
    """`correct(mean, P, sensor, j, z, Q)`: the Kalman filter's, headings and bearings wrapped."""
    rng = np.random.default_rng(7)
    sensor = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
    Q = np.diag([0.01, 0.0004])
    for bearing in (0.3, math.pi - 0.001, -math.pi + 0.001):
        mean, P = _slam_state(rng)
        j = 1
        at = slice(3 + 2 * j, 5 + 2 * j)
        direction = mean[2] + bearing
        mean[at] = mean[:2] + 3.0 * np.array([math.cos(direction), math.sin(direction)])
        expected = range_and_bearing(mean[:3], mean[at])
        innovation = np.array([0.05, math.copysign(0.01, bearing)])
        z = expected + innovation
        z[1] = math.remainder(z[1], math.tau)
        H = differences(lambda x: unwrapped(range_and_bearing(x[:3], x[at]), expected), mean)  # noqa: B023
        changes, covariances = wrong_corrections(P, H, Q, innovation, z - expected)
        unmoved, other = H.copy(), H.copy()
        unmoved[:, at] = 0.0
        other[:, 3:5], other[:, at] = H[:, at], 0.0
        changes["H has the derivatives by the landmark, H_m"] = kalman_gain(P, unmoved, Q) @ innovation
        changes["landmark j has the columns 3 + 2 j and 4 + 2 j of the state"] = kalman_gain(P, other, Q) @ innovation
        fixed = H.copy()
        fixed[:, :3] = 0.0
        changes["H has the derivatives by the pose, H_x"] = kalman_gain(P, fixed, Q) @ innovation
        found, covariance = correct(mean.copy(), P.copy(), sensor, j, z, Q)
        require(np.shape(found) == (7,), f"mean: expected shape (7,), got {np.shape(found)}")
        change = found - mean
        change[2] = math.remainder(change[2], math.tau)
        for value in changes.values():
            value[2] = math.remainder(value[2], math.tau)
        expect("change of the mean", change, kalman_gain(P, H, Q) @ innovation, 1e-6, changes)
        right = (np.eye(7) - kalman_gain(P, H, Q) @ H) @ P
        expect("covariance after the correction", covariance, right, 1e-6, covariances)
    _heading_stays_in_range(correct, sensor, Q)


def _heading_stays_in_range(
    correct: Callable[[FloatArray, FloatArray, LandmarkModel, int, FloatArray, FloatArray], Slam],
    sensor: LandmarkModel,
    Q: FloatArray,
) -> None:
    """A correction across pi: the docstring demands a heading in [-pi, pi)."""
    mean = np.array([0.0, 0.0, math.pi - 0.001, -3.0, 0.0])
    z = range_and_bearing(mean[:3], mean[3:]) - [0.0, 0.1]
    found, _ = correct(mean, np.diag([1e-6, 1e-6, 0.04, 1e-6, 1e-6]), sensor, 0, z, Q)
    require(-math.pi <= found[2] < math.pi, f"the heading is {found[2]:.2f} rad: wrap it to [-pi, pi)")


def slam_is_the_kalman_filter(run: SlamRun) -> None:
    """A robot that cannot turn and measures positions: textbook equations over [x, y, m_1, m_2], in turn."""
    rng = np.random.default_rng(0)
    R = np.diag([0.04, 0.01])
    Q = np.diag([0.09, 0.25])
    big = 1e9  # a landmark of which nothing is known
    mean = np.zeros(6)
    P = np.diag([0, 0, big, big, big, big])
    steps = []
    for k in range(12):
        names = [[0, 1], [1], [0]][k % 3]
        z = rng.normal([[3.0, 1.0], [2.0, -2.0]], 0.5)[names]
        steps.append(LandmarkMeasurements(np.array([0.5, 0.1, 0.0]), np.diag([0.04, 0.01, 0.0]), names, z))
        mean[:2] += [0.5, 0.1]
        P[:2, :2] += R
        for j, value in zip(names, z, strict=True):
            H = np.zeros((2, 6))
            H[:, :2] = -np.eye(2)
            H[:, 2 + 2 * j : 4 + 2 * j] = np.eye(2)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Q)
            mean = mean + K @ (value - H @ mean)
            P = (np.eye(6) - K @ H) @ P
            P = (P + P.T) / 2
    found, covariance = run(RelativePosition(sigma_x_m=0.3, sigma_y_m=0.5), steps)
    some = [0, 1, 3, 4, 5, 6]  # all but the heading
    # The textbook's filter begins with a variance of 1e9, of which rounding leaves 1e9 * 2e-16 * a few.
    expect("mean of the linear case", found[some], mean, 1e-5)
    expect("covariance of the linear case", covariance[np.ix_(some, some)], P, 1e-5)


RING = np.array([0.0, 4.0]) + 6.0 * np.column_stack(
    [np.cos(np.arange(12) * math.pi / 6), np.sin(np.arange(12) * math.pi / 6)]
)
"""Landmarks (12, 2) around the circle that `drive_in_a_circle` drives."""


def drive_in_a_circle(rng: Rng, count: int = 126) -> tuple[list[LandmarkMeasurements], FloatArray]:
    """Range and bearing of the landmarks within 5 m, once around a circle of 4 m radius; and the true poses."""
    sensor = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
    increment = np.array([0.2, 0.0, 0.05])
    noise = np.diag(np.square([0.025, 0.025, 0.015]))
    pose = np.zeros(3)
    steps = []
    truth = []
    for _ in range(count):
        pose = compose(pose, increment + np.sqrt(np.diag(noise)) * rng.standard_normal(3))
        truth.append(pose)
        names = np.flatnonzero(np.hypot(*(RING - pose[:2]).T) < 5.0)
        z = sensor.linearize(pose, RING[names])[0] + [0.1, 0.02] * rng.standard_normal((len(names), 2))
        steps.append(LandmarkMeasurements(increment, noise, names.tolist(), z))
    return steps, np.array(truth)


def ring_is_mapped(run: SlamRun) -> None:
    """Final pose and landmarks of ten drives: errors as large as the covariance states.

    The normalized squared error of 27 numbers is chi-square distributed with a mean of 27, over ten drives with a
    standard deviation of sqrt(2 * 27 / 10) = 2.3; the band is four of these.
    """
    nees = []
    for seed in range(10):
        steps, truth = drive_in_a_circle(np.random.default_rng(seed))
        mean, P = run(RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02), steps)
        order = list(dict.fromkeys(name for step in steps for name in step.names))
        error = mean - np.concatenate([truth[-1], RING[order].ravel()])
        error[2] = wrap(error[2])
        nees.append(error @ np.linalg.solve(P, error))
    value = float(np.mean(nees))
    why = "too small: errors are greater than it states" if value > 27 else "too large: errors are less than it states"
    require(abs(value - 27) < 4 * 2.3, f"normalized squared error {value:.1f}, expected 27: the covariance is {why}")
