"""A robot that drives in a circle among landmarks, with noise as the models have it, and what it sees."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, LandmarkStep, RangeBearing
from gridslam.models.motion import DiffusionMotion

MOTION = DiffusionMotion(sigma_xy_m=0.05, sigma_theta_rad=0.03)
INCREMENT = np.array([0.2, 0.0, 0.05])  # a circle of radius 4 m, once around in 126 steps


def ring(count: int, radius: float = 6.0) -> np.ndarray:
    """Landmarks (count, 2) on a circle around the one that is driven."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.array([0.0, 4.0]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def drive(
    landmarks: np.ndarray,
    steps: int,
    rng: np.random.Generator,
    sensor: LandmarkModel | None = None,
    motion: DiffusionMotion = MOTION,
    reach_m: float = 5.0,
) -> tuple[list[LandmarkStep], np.ndarray]:
    """Steps, and the true poses (steps, 3); the landmarks' ids are their places plus 100."""
    sensor = sensor or RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
    pose, log, truth = np.zeros(3), [], []
    for k in range(steps):
        pose = motion(INCREMENT)(pose[None], rng)[0]
        seen = np.flatnonzero(np.hypot(*(landmarks - pose[:2]).T) < reach_m)
        exact = sensor.linearize(pose, landmarks[seen])[0].reshape(-1, 2)
        noise = sensor.noise(LandmarkObservations.of(exact))
        values = exact + np.sqrt(np.diagonal(noise, axis1=1, axis2=2)) * rng.standard_normal(exact.shape)
        log.append(LandmarkStep(k * 10**8, INCREMENT, None, LandmarkObservations.of(values, seen + 100)))
        truth.append(pose)
    return log, np.array(truth)


def dead_reckoning(steps: int) -> np.ndarray:
    """Poses (steps, 3) where the robot drives without noise."""
    poses = [INCREMENT]
    for _ in range(steps - 1):
        poses.append(compose(poses[-1], INCREMENT))
    return np.array(poses)
