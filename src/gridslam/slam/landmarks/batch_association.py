"""Correspondences of a whole log: by a particle filter, revised at poses that know the whole log.

A filter decides when an observation comes. Where the log is complete it can be asked again: at the poses of GraphSLAM
with the correspondences so far, which later observations have corrected, each observation has a nearest landmark, and
two landmarks at one place that are never observed together are one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from scipy.optimize import linear_sum_assignment

from gridslam.models.landmark import LandmarkModel, LandmarkObservations, LandmarkStep, linearize_calibrated
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam, LandmarkGraphSolution
from gridslam.slam.landmarks.particles import smooth_trajectory
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.marginals import Marginals
from gridslam.slam.pose_graph.robust import CauchyEstimator
from gridslam.types import FloatArray, IntArray, MotionModel

__all__ = ["BatchAssociation"]

_NONE = -1


@final
@dataclass(frozen=True)
class BatchAssociation:
    """Find the correspondences of all observations of a log.

    Attributes
    ----------
    slam : FastSlam2
        The filter, in which each particle estimates its own correspondences.
    sensor : LandmarkModel
        p(z | x, m) of one landmark, its sigmas those of one observation relative to another of the same time.
    bias : SystematicErrors
        Of odometry and sensor.
    gate : float
        Greatest squared Mahalanobis distance of an observation, at the smoothed pose, from its landmark.
    merge_gate : float
        Greatest squared Mahalanobis distance between two landmarks that are merged.
    merge_m : float, m
        And their greatest distance.
    least_observations : int
        A landmark of fewer observations is none.
    rounds : int
        Revisions at most.
    particles : int
        Of the filter. After an interval without observations the first one may be of any of several landmarks in any of
        several directions, and some particles must be right: of MRCLAM's intervals of 30 s, in a room of 15 barcodes,
        20 particles seldom survive all.
    solver : GraphSlam
        For the smoothed poses.

    References
    ----------
    M. Kaess, F. Dellaert, Covariance recovery from a square root information matrix for data association, RAS 2009
    (tests by marginal covariances); Probabilistic Robotics, 11.6 (data association in GraphSLAM, by tests that two
    landmarks are one, repeated after each solution).
    """

    slam: FastSlam2
    sensor: LandmarkModel
    bias: SystematicErrors
    gate: float = 16.0
    merge_gate: float = 16.0
    merge_m: float = 0.5
    least_observations: int = 3
    rounds: int = 6
    particles: int = 200
    solver: GraphSlam = field(default_factory=lambda: GraphSlam(first_guess="given", robust=CauchyEstimator()))

    def __call__(
        self,
        steps: Sequence[LandmarkStep],
        motion: MotionModel,
        rng: np.random.Generator,
        on_progress: Callable[[], None] = lambda: None,
    ) -> list[LandmarkStep]:
        """Return the steps with correspondences; observations of no landmark are left out.

        Parameters
        ----------
        steps : sequence of LandmarkStep
            Of the whole log; correspondences that they have are not used.
        motion : MotionModel
            For increments without covariance.
        rng : numpy.random.Generator
        on_progress : callable
            Called after each step of the filter, and after each revision.
        """
        labels = self._filter(steps, motion, rng, on_progress)
        graph = LandmarkGraphSlam(self.sensor, self.solver, bias=self.bias)
        solution: LandmarkGraphSolution | None = None
        for _ in range(self.rounds):
            labels = self._leave_out_few(labels)
            before = labels
            solution = graph.solve(_label(steps, labels), motion, solution)
            labels = self._merge(labels, solution)
            if all(np.array_equal(a, b) for a, b in zip(labels, before, strict=True)):
                calibration = self.bias.calibration(solution.systematic_errors)
                labels = self._assign(steps, solution.poses, solution.landmarks, calibration, _SMOOTHED)
            on_progress()
            if all(np.array_equal(a, b) for a, b in zip(self._leave_out_few(labels), before, strict=True)):
                break
        return _label(steps, self._leave_out_few(labels))

    def _filter(
        self,
        steps: Sequence[LandmarkStep],
        motion: MotionModel,
        rng: np.random.Generator,
        on_progress: Callable[[], None],
    ) -> list[IntArray]:
        """Landmarks of each step by the smoothed path and the map of the best particle."""
        state = self.slam.init(self.particles)
        motions = [step.motion(motion) for step in steps]
        for step, moved in zip(steps, motions, strict=True):
            state, _ = self.slam.step(state, moved, step.observations.drop_correspondences(), rng)
            on_progress()
        bias = self.slam.landmarks.bias
        poses = smooth_trajectory(state, state.best, motions, bias)[1:]
        calibration = bias.calibration(state.state_means[state.best, 3:])
        return self._assign(steps, poses, state.landmark_map(), calibration, _FILTERED)

    def _leave_out_few(self, labels: list[IntArray]) -> list[IntArray]:
        """Regard observations of landmarks that are observed seldom as of none."""
        names, counts = np.unique(np.concatenate(labels), return_counts=True)
        kept = names[(counts >= self.least_observations) & (names >= 0)]
        return [np.where(np.isin(of_step, kept), of_step, _NONE) for of_step in labels]

    def _merge(self, labels: list[IntArray], solution: LandmarkGraphSolution) -> list[IntArray]:
        """Merge landmarks at one place, the nearest first, unless they are observed at one time."""
        found = solution.landmarks
        place = {name: k for k, name in enumerate(found.names.tolist())}
        together = np.eye(len(found), dtype=np.bool_)
        for of_step in labels:
            seen = [place[name] for name in of_step.tolist() if name in place]
            together[np.ix_(seen, seen)] = True
        distances = np.hypot(*(found.positions[:, None] - found.positions).transpose(2, 0, 1))
        candidates = np.argwhere(np.triu((distances < self.merge_m) & ~together))
        if not len(candidates):
            return labels
        marginals = Marginals(solution.solution.weighted_graph)
        first = len(solution.poses) + 1
        scored = list[tuple[float, int, int]]()
        for i, j in candidates.tolist():
            of_i = marginals.covariances_with(first + i)[:, :2, :2]
            shared = of_i[first + j]
            covariance = found.covariances[i] + found.covariances[j] - shared - shared.T
            apart = found.positions[i] - found.positions[j]
            scored.append((float(mahalanobis(apart, covariance + _SURVEY * np.eye(2))[0]), i, j))
        name_of = found.names.copy()
        merged = set[int]()
        for squared, i, j in sorted(scored):
            if squared <= self.merge_gate and i not in merged and j not in merged:
                name_of[j] = found.names[i]
                merged |= {i, j}
        renamed = dict(zip(found.names.tolist(), name_of.tolist(), strict=True))
        return [np.array([renamed.get(name, _NONE) for name in of_step.tolist()], np.int64) for of_step in labels]

    def _assign(
        self,
        steps: Sequence[LandmarkStep],
        poses: FloatArray,
        landmarks: LandmarkMap,
        calibration: FloatArray,
        spread: FloatArray,
    ) -> list[IntArray]:
        """Assign the observations of each step to the landmarks that they are nearest to, each to another one.

        `spread` (2, 2) is what the poses, of which the sensor sees the landmarks, add to the noise of an observation.
        """
        labels = list[IntArray]()
        for step, pose in zip(steps, poses, strict=True):
            observations = step.observations
            chosen = np.full(len(observations), _NONE)
            if len(observations) and len(landmarks):
                predicted, _, _, _ = linearize_calibrated(self.sensor, pose, landmarks.positions, calibration)
                residuals = self.sensor.residual(observations.values[:, None], predicted)
                covariances = self.sensor.noise(observations) + spread
                squared, _ = mahalanobis(residuals, covariances[:, None])
                cost = np.minimum(squared, self.gate)
                rows, columns = linear_sum_assignment(cost)
                near = cost[rows, columns] < self.gate
                chosen[rows[near]] = landmarks.names[columns[near]]
            labels.append(chosen)
        return labels


_SURVEY = 0.01**2  # m^2: two landmarks are not apart by less than 1 cm
_SMOOTHED = np.diag([0.05**2, 0.015**2])
"""What a smoothed pose errs by, in an observation: m and rad."""
_FILTERED = 4 * _SMOOTHED
"""What a pose errs by that a filter has found."""


def _label(steps: Sequence[LandmarkStep], labels: Sequence[IntArray]) -> list[LandmarkStep]:
    """Steps with the observations that have a landmark, and its name."""
    labelled = list[LandmarkStep]()
    for step, names in zip(steps, labels, strict=True):
        kept = np.flatnonzero(names >= 0)
        seen = step.observations
        covariances = None if seen.covariances is None else seen.covariances[kept]
        observations = LandmarkObservations(seen.values[kept], names[kept], covariances, seen.passed_s)
        labelled.append(replace(step, observations=observations))
    return labelled
