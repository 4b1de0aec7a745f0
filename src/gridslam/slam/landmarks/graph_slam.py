"""GraphSLAM on landmarks: full SLAM, all poses and all landmarks at once, as the most likely ones of a sparse graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import compose, compose_jacobians, inverse
from gridslam.models.association import signatures
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, LandmarkStep, RangeBearing
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.slam.landmarks.small_gaussians import inverse_2x2, transform_covariances
from gridslam.slam.pose_graph.graph_slam import GraphSlam, GraphSolution
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, MotionModel

_ALMOST_EXACT = 1e-12  # m^2 and rad^2 added to covariances, since an increment may have no noise
_ANY = 1.0  # rad^-2, of a heading without any other information


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkGraphSolution:
    """The solution of GraphSLAM.

    Attributes
    ----------
    poses, covariances : (T, 3), (T, 3, 3) float64
        After each step, map frame, given the pose at the begin.
    landmarks : LandmarkMap
        In the order of first sight.
    solution : GraphSolution
        Of the whole graph: the begin, the poses, the landmarks.
    """

    poses: FloatArray
    covariances: FloatArray
    landmarks: LandmarkMap
    solution: GraphSolution

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of chi2: two for each observation but the first of each landmark."""
        return 2 * int((self.landmarks.observations - 1).sum())


@final
@dataclass(frozen=True)
class LandmarkGraphSlam:
    """Full SLAM on landmarks with known correspondences.

    The least squares have many minima, and landmarks, which have no headings, give no first guess as other poses do. So
    the graph is solved as it grows: each time what is new is guessed by dead reckoning from what is solved.

    Attributes
    ----------
    sensor : LandmarkModel
        p(z | x, m) of one landmark.
    solver : GraphSlam
        If it is robust, it down-weights the observations.
    growth : int
        Steps from one solution to the next; over 200 steps of Victoria Park, 110 m, dead reckoning turns by 0.1 rad.

    References
    ----------
    Probabilistic Robotics, Tables 11.1 to 11.5. Where the book eliminates all landmarks and then solves for the
    poses, the sparse factorization finds its own order of elimination.
    """

    sensor: LandmarkModel = field(default_factory=RangeBearing)
    solver: GraphSlam = field(default_factory=lambda: GraphSlam(first_guess="given"))
    growth: int = 200

    def solve(self, steps: Iterable[LandmarkStep], motion: MotionModel) -> LandmarkGraphSolution:
        """Find the most likely poses and landmarks of a whole log.

        Parameters
        ----------
        steps : iterable of LandmarkStep
        motion : MotionModel
            For increments without covariance.

        Raises
        ------
        ArgumentError
            There is no step, or the observations have no correspondences.
        """
        problem = LandmarkGraph.of(steps, motion, self.sensor)
        if not len(problem):
            raise ArgumentError("steps", "at least one", "none")
        nodes = np.zeros((1, 3))
        known = 0
        for until in [*range(self.growth, len(problem), self.growth), len(problem)]:
            solution = self.solver.solve(problem.begin(until, nodes[: known + 1], nodes[known + 1 :]))
            nodes = solution.poses
            known = until
        covariances = marginal_covariances(solution.weighted_graph)
        poses = slice(1, known + 1)
        landmarks = slice(known + 1, None)
        observations = np.bincount(problem.place, minlength=len(problem.names))
        found = LandmarkMap(problem.names, nodes[landmarks, :2], covariances[landmarks, :2, :2], observations)
        return LandmarkGraphSolution(nodes[poses], covariances[poses], found, solution)


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
        steps = list(steps)
        moments = [step.motion(motion).moments(np.zeros((1, 3))) for step in steps]
        increments = np.array([increment for (increment,), _ in moments]).reshape(-1, 3)
        spreads = np.array([spread for _, (spread,) in moments]).reshape(-1, 3, 3)
        to_end = compose_jacobians(inverse(increments), increments)[1]  # the graph's: the frame in which each ends
        spread_at_end = transform_covariances(to_end, spreads) + _ALMOST_EXACT * np.eye(3)
        observed = [step.observations for step in steps if len(step.observations)]
        reported = [name for observations in observed for name in signatures(observations).tolist()]
        place_of = {name: place for place, name in enumerate(dict.fromkeys(reported))}
        place = np.array([place_of[name] for name in reported], np.int64)
        located = [_locate(observations, sensor) for observations in observed]
        points = np.zeros((len(reported), 3))
        points[:, :2] = np.concatenate([np.empty((0, 2)), *(positions for positions, _ in located)])
        covariances = np.concatenate([np.empty((0, 2, 2)), *(covariances for _, covariances in located)])
        information = np.zeros((len(reported), 3, 3))
        information[:, :2, :2] = inverse_2x2(covariances)
        information[np.unique(place, return_index=True)[1], 2, 2] = _ANY
        return cls(
            increments,
            np.asarray(np.linalg.inv(spread_at_end), np.float64),
            np.repeat(np.arange(1, len(steps) + 1), [len(step.observations) for step in steps]),
            place,
            points,
            information,
            np.array(list(place_of), np.int64),
        )

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


def _locate(observations: LandmarkObservations, sensor: LandmarkModel) -> tuple[FloatArray, FloatArray]:
    """Observations as positions (K, 2) in the base frame, and their covariances (K, 2, 2)."""
    here = np.zeros(3)
    points = sensor.locate(here, observations.values)
    root = inverse_2x2(sensor.linearize(here, points)[2])
    return points, transform_covariances(root, sensor.noise(observations))
