"""The relations metric: how well a trajectory reproduces known relative poses, wherever the map as a whole lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.evaluation.trajectory import interpolate
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray, IntArray, Trajectory

__all__ = ["RelationErrors", "Relations", "relation_errors"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """True relative poses: where the robot stood at times `to_ns`, seen from where it was at times `from_ns`.

    `from_ns` and `to_ns` are (M,) int64 ns, `poses` (M, 3) float64, M >= 1.

    Raises ArgumentError where lengths differ or there is no relation.
    """

    from_ns: IntArray
    to_ns: IntArray
    poses: FloatArray

    def __post_init__(self) -> None:
        """Check that each relation has two times and a pose."""
        if not len(self.from_ns) == len(self.to_ns) == len(self.poses) > 0 or self.poses.shape[1:] != (3,):
            shapes = (self.from_ns.shape, self.to_ns.shape, self.poses.shape)
            raise ArgumentError("Relations", "shapes (M,), (M,), (M, 3), M > 0", shapes)


@final
@dataclass(frozen=True, slots=True)
class RelationErrors:
    """Statistics over `n` relations: translation in m, rotation in degrees, std of the population.

    `exact` is the share of the relations' times with a pose of the trajectory within 1 ms; the rest were interpolated.
    """

    n: int
    exact: float
    trans_mean_m: float
    trans_std_m: float
    trans_max_m: float
    rot_mean_deg: float
    rot_std_deg: float
    rot_max_deg: float


def relation_errors(trajectory: Trajectory, relations: Relations) -> RelationErrors:
    """Score a trajectory: component difference of each estimated and true relative pose.

    Parameters
    ----------
    trajectory : Trajectory
        Poses in any frame; only relative ones count.
    relations : Relations
        Truth between pairs of times.

    Raises
    ------
    ArgumentError
        A time lies outside the trajectory by more than 1 ms.

    Source: R. Kuemmerle et al., On measuring the accuracy of SLAM algorithms, Autonomous Robots 27 (2009), Section 3,
    with translation and rotation reported apart and not squared.
    """
    first, exact_first = interpolate(trajectory, relations.from_ns)
    second, exact_second = interpolate(trajectory, relations.to_ns)
    error = between(first, second) - relations.poses
    trans = np.hypot(error[:, 0], error[:, 1])
    rot = np.degrees(np.abs(wrap(error[:, 2])))
    return RelationErrors(
        n=len(trans),
        exact=float((exact_first.mean() + exact_second.mean()) / 2),
        trans_mean_m=float(trans.mean()),
        trans_std_m=float(trans.std()),
        trans_max_m=float(trans.max()),
        rot_mean_deg=float(rot.mean()),
        rot_std_deg=float(rot.std()),
        rot_max_deg=float(rot.max()),
    )
