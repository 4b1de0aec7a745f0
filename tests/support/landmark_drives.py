"""Simulated drives among landmarks with all errors that EKF localization estimates, and how consistent it is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gridslam.api.landmarks import COMMANDS, MOTION
from gridslam.evaluation.consistency import nees
from gridslam.geometry.angles import wrap
from gridslam.localization.ekf import EkfLocalization, KnownLandmarks
from gridslam.models.association import KnownCorrespondence, MaximumLikelihood
from gridslam.models.landmark import (
    DepthBearing,
    LandmarkModel,
    LandmarkObservations,
    LandmarkStep,
    linearize_calibrated,
    with_durations,
)

SENSOR = DepthBearing()
START = np.diag([0.1, 0.1, 0.1]) ** 2
PERIOD_S = 0.2
_SIDES_M = np.array([14.0, 9.0])
_REACH_M, _HALF_VIEW_RAD = 6.0, 0.5  # what a camera sees
_CLEAR_M = 0.5  # no landmark is seen from nearer: there the sensor is far from linear
_STEP_M, _TURN_RAD = 0.06, 0.08

ASSOCIATIONS = {False: KnownCorrespondence(), True: MaximumLikelihood(match_gate=100.0, new_gate=100.0)}
"""Of known and of unknown correspondences; the gates are those of a complete map."""


class LandmarkDrive(NamedTuple):
    """Landmarks, steps, and true poses (T, 3)."""

    landmarks: KnownLandmarks
    steps: list[LandmarkStep]
    truth: np.ndarray

    @classmethod
    def of(cls, seed: int, steps: int = 1500, landmarks: int = 30) -> LandmarkDrive:
        """Drive through a room; all errors are drawn from the priors and the noise of the filter's own models."""
        rng = np.random.default_rng(seed)
        places = rng.random((landmarks, 2)) * _SIDES_M
        systematic = rng.multivariate_normal(np.zeros(len(COMMANDS)), COMMANDS.covariance())
        own = rng.standard_normal((landmarks, 2))
        kept = math.exp(-PERIOD_S / SENSOR.correlation_s)
        pose = np.array([*(0.5 * _SIDES_M), 0.0])
        log, truth = [], []
        for k in range(steps):
            increment = _command(pose, k)
            moved = increment + COMMANDS.by_errors(increment) @ systematic
            pose = MOTION(moved)(pose[None], rng)[0]
            own = kept * own + math.sqrt(1 - kept**2) * rng.standard_normal(own.shape)
            seen = _seen(pose, places) if k % 3 == 0 else np.empty(0, np.int64)
            calibration = COMMANDS.calibration(systematic)
            exact = linearize_calibrated(SENSOR, pose, places[seen], calibration)[0].reshape(-1, 2)
            sigma = np.sqrt(np.diagonal(SENSOR.noise(LandmarkObservations.of(exact)), axis1=1, axis2=2))
            share = SENSOR.correlated_share
            errors = math.sqrt(share) * own[seen] + math.sqrt(1 - share) * rng.standard_normal((len(seen), 2))
            observed = LandmarkObservations.of(exact + sigma * errors, seen)
            log.append(LandmarkStep(round(k * PERIOD_S * 1e9), increment, None, observed))
            truth.append(pose)
        return cls(KnownLandmarks.of(np.arange(landmarks), places), list(with_durations(log)), np.array(truth))

    def nees(self, seed: int, *, unknown: bool, sensor: LandmarkModel = SENSOR) -> np.ndarray:
        """NEES (T,) of the pose, from a first one that is off by what its covariance states."""
        ekf = EkfLocalization(self.landmarks, sensor, ASSOCIATIONS[unknown], COMMANDS)
        first = np.array([*(0.5 * _SIDES_M), 0.0])
        belief = ekf.init(np.random.default_rng(seed).multivariate_normal(first, START), START)
        poses, covariances = [], []
        for step in self.steps:
            observations = step.observations.drop_correspondences() if unknown else step.observations
            belief, _ = ekf.step(belief, step.motion(MOTION), observations)
            poses.append(belief.pose)
            covariances.append(belief.covariance)
        return nees(np.array(poses), self.truth, np.array(covariances))


def _command(pose: np.ndarray, k: int) -> np.ndarray:
    """Increment (3,) that leads on towards a point that wanders about the room."""
    goal = _SIDES_M * (0.5 + 0.35 * np.array([math.sin(0.011 * k), math.cos(0.017 * k)]))
    dx, dy = goal - pose[:2]
    turn = wrap(math.atan2(dy, dx) - float(pose[2]))
    return np.array([_STEP_M, 0.0, min(max(float(turn), -_TURN_RAD), _TURN_RAD)])


def _seen(pose: np.ndarray, places: np.ndarray) -> np.ndarray:
    dx, dy = (places - pose[:2]).T
    away = np.hypot(dx, dy)
    aside = np.abs(wrap(np.arctan2(dy, dx) - pose[2]))
    return np.flatnonzero((away > _CLEAR_M) & (away < _REACH_M) & (aside < _HALF_VIEW_RAD))
