"""People who walk about while the robot drives."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray

__all__ = ["PeopleConfig", "simulate_walkers"]


@final
@parameters(frozen=True, config=STRICT)
class PeopleConfig:
    """People who walk up and down the robot's route, each at a pace of their own; they make way for the robot.

    Parameters
    ----------
    count : int, >= 0
    radius_m : float, m, > 0
        Of the disc a beam meets: a body at the height of a lidar.
    speed_m_s : float, m/s, > 0
        Mean pace; individual ones are between half and one and a half of it.
    distance_m : float, m, > 0
        Least distance kept from the robot's centre.
    """

    count: int = Field(default=0, ge=0)
    radius_m: float = Field(default=0.2, gt=0)
    speed_m_s: float = Field(default=1.0, gt=0)
    distance_m: float = Field(default=0.8, gt=0)


def simulate_walkers(
    route: FloatArray, people: PeopleConfig, rng: np.random.Generator
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """People who walk along the route (K, 2) and back for ever.

    Returns
    -------
    callable (robot (N, 3), seconds (N,)) -> (N, P, 2) float64, m
        Where they are at those times, with the robot at those poses.
    """
    steps = np.diff(route, axis=0)
    nodes = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    length = nodes[-1]
    begin = rng.uniform(0.0, 2 * length, people.count)
    pace = people.speed_m_s * rng.uniform(0.5, 1.5, people.count)

    def places(robot: FloatArray, seconds: FloatArray) -> FloatArray:
        at = np.abs(np.mod(begin + pace * seconds[:, None], 2 * length) - length)
        wanted = np.stack([np.interp(at, nodes, route[:, k]) for k in range(2)], axis=-1)
        away = wanted - robot[:, None, :2]
        distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-9)[..., None]
        kept: FloatArray = robot[:, None, :2] + away * np.maximum(1.0, people.distance_m / distance)
        return kept

    return places
