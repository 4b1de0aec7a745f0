"""Landmarks and poses as one pose graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.se2 import compose, compose_jacobians, inverse
from gridslam.models.association import signatures
from gridslam.models.landmark import LandmarkModel
from gridslam.models.landmark_observations import LandmarkStep
from gridslam.slam.landmarks.small_gaussians import inverse_2x2
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, MotionModel

__all__ = ["LandmarkGraph"]

_ALMOST_EXACT = 1e-12  # m^2 and rad^2 added to covariances, since an increment may have no noise
_ANY = 1.0  # rad^-2, of a heading without any other information


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkGraph:
    """The measurements of a log: T + 1 poses, including the first one, and M landmarks.

    A landmark is a node without a heading, and an observation of it an edge with a position only: its
    information about the heading is 0. So that there is one least chi2, the first observation of each landmark gives it
    the heading of the pose of that observation. It is the only measurement of this heading, hence met exactly: it adds
    nothing to chi2 and pulls at nothing, and neither solver nor covariances need to know of landmarks.

    Attributes
    ----------
    increments, increment_information : (T, 3), (T, 3, 3) float64
        Measurements and information of the edges between poses.
    at : (K,) int64
        Index of the pose of each observation, ascending.
    place : (K,) int64
        Which landmark it is of, by the order of first sight.
    points, point_information : (K, 3), (K, 3, 3) float64
        Measurements and information of their edges.
    names : (M,) int64
        Signatures of the landmarks in that order.
    """

    increments: FloatArray
    increment_information: FloatArray
    at: IntArray
    place: IntArray
    points: FloatArray
    point_information: FloatArray
    names: IntArray

    @classmethod
    def of(cls, steps: Iterable[LandmarkStep], motion: MotionModel, sensor: LandmarkModel) -> LandmarkGraph:
        """Convert the steps of a log; observations become positions in the base frame, with covariances to first order.

        Raises ArgumentError if an observation has no correspondence.
        """
        increments, spreads, at, told, points, covariances = [], [], [], [], [], []
        for t, step in enumerate(steps, 1):
            (increment,), (spread,) = step.motion(motion).moments(np.zeros((1, 3)))
            increments.append(increment)
            spreads.append(spread)
            if len(step.observations):
                seen, uncertain = _points(step, sensor)
                at += [t] * len(seen)
                told += signatures(step.observations).tolist()
                points += list(seen)
                covariances += list(uncertain)
        names = list(dict.fromkeys(told))
        place_of = {name: place for place, name in enumerate(names)}
        place = np.array([place_of[name] for name in told], np.int64)
        moved = np.array(increments).reshape(-1, 3)
        spread_at_end = _at_the_end(np.array(spreads).reshape(-1, 3, 3), moved) + _ALMOST_EXACT * np.eye(3)
        measured, information = np.zeros((len(told), 3)), np.zeros((len(told), 3, 3))
        measured[:, :2] = np.array(points).reshape(-1, 2)
        information[:, :2, :2] = inverse_2x2(np.array(covariances).reshape(-1, 2, 2))
        information[np.unique(place, return_index=True)[1], 2, 2] = _ANY
        increment_information = np.asarray(np.linalg.inv(spread_at_end), np.float64)
        where = np.array(at, np.int64), place
        return cls(moved, increment_information, *where, measured, information, np.array(names, np.int64))

    def __len__(self) -> int:
        """Return the number T of steps."""
        return len(self.increments)

    def begin(self, steps: int, poses: FloatArray, landmarks: FloatArray) -> PoseGraph:
        """Return the graph of the first steps: its poses, then the landmarks seen by then.

        Parameters
        ----------
        steps : int
            In [1, T].
        poses, landmarks : (P, 3), (L, 3) float64
            First guess of the first P >= 1 poses and L landmarks; the others follow from these by dead reckoning, and
            from where they are seen first.
        """
        known = list(poses)
        for increment in self.increments[len(poses) - 1 : steps]:
            known.append(compose(known[-1], increment))
        seen = int(np.searchsorted(self.at, steps, side="right"))
        places, first = np.unique(self.place[:seen], return_index=True)
        new = first[len(landmarks) :]
        nodes = np.array(known)
        located = np.concatenate([landmarks, compose(nodes[self.at[new]], self.points[new])])
        chain = np.stack([np.arange(steps), np.arange(1, steps + 1)], axis=1)
        return PoseGraph(
            poses=np.concatenate([nodes, located[: len(places)]]),
            edges=np.concatenate([chain, np.stack([self.at[:seen], steps + 1 + self.place[:seen]], axis=1)]),
            measurements=np.concatenate([self.increments[:steps], self.points[:seen]]),
            information=np.concatenate([self.increment_information[:steps], self.point_information[:seen]]),
            trusted=np.arange(steps + seen) < steps,
        )


def _points(step: LandmarkStep, sensor: LandmarkModel) -> tuple[FloatArray, FloatArray]:
    """Observations as positions (K, 2) in the base frame, and their covariances (K, 2, 2)."""
    here = np.zeros(3)
    points = sensor.locate(here, step.observations.values)
    root = inverse_2x2(sensor.linearize(here, points)[2])
    return points, root @ sensor.noise(step.observations) @ root.swapaxes(1, 2)


def _at_the_end(covariances: FloatArray, increments: FloatArray) -> FloatArray:
    """Turn covariances (T, 3, 3) from the frame in which increments begin to that in which they end: the graph's."""
    turn = compose_jacobians(inverse(increments), increments)[1]
    return np.asarray(turn @ covariances @ turn.swapaxes(1, 2))
