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

from gridslam.models.landmark import (
    LandmarkModel,
    LandmarkObservations,
    LandmarkStep,
    linearize_calibrated,
    locate_calibrated,
)
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam, LandmarkGraphSolution
from gridslam.slam.landmarks.merging import MergeSearch
from gridslam.slam.landmarks.particles import smooth_trajectory
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import CauchyEstimator
from gridslam.types import FloatArray, IntArray, MotionModel

__all__ = ["BatchAssociation"]

_NONE = -1


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Landmarks of all observations, the graph's solution with them, and their cost."""

    labels: list[IntArray]
    solution: LandmarkGraphSolution
    cost: float


@final
@dataclass(frozen=True)
class BatchAssociation:
    """Find the correspondences of all observations of a log.

    A particle filter that takes a wrong turn after an interval without observations doubles half of the map. So the
    filter starts several times, each time with odometry and sensor calibrated by what was found so far, and the
    correspondences of the least cost are taken: chi2 of the graph, and what observations without a landmark and the
    landmarks themselves cost. The correspondences that two starts agree about are taken as found.

    Attributes
    ----------
    slam : FastSlam2
        The filter, in which each particle estimates its own correspondences.
    sensor : LandmarkModel
        p(z | x, m) of one landmark, its sigmas those of one observation relative to another of the same time.
    bias : SystematicErrors
        Of odometry and sensor.
    smoothing : MotionModel or None
        For increments without covariance, when the correspondences are revised. None takes the filter's.
    gate : float
        Greatest squared Mahalanobis distance of an observation, at the smoothed pose, from its landmark.
    merge : MergeSearch
        Finds landmarks that are one.
    least_observations : int
        A landmark of fewer observations is none.
    rounds : int
        Revisions at most.
    particles : int
        Of the filter. After an interval without observations the first one may be of any of several landmarks in any of
        several directions, and some particles must be right: of MRCLAM's intervals of 30 s, in a room of 15 barcodes,
        20 particles seldom survive all.
    starts : int
        Runs of the filter at most.
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
    smoothing: MotionModel | None = None
    gate: float = 16.0
    merge: MergeSearch = field(default_factory=MergeSearch)
    least_observations: int = 3
    rounds: int = 10
    particles: int = 200
    starts: int = 4
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
        best: _Found | None = None
        for _ in range(self.starts):
            calibrated = steps if best is None else self._calibrate(steps, best.solution.systematic_errors)
            labels = self._filter(calibrated, motion, rng, on_progress)
            found = self._revise(steps, labels, self.smoothing or motion, on_progress)
            agreed = best is not None and _share_agreed(best.labels, found.labels) >= _AGREED
            if best is None or found.cost < best.cost:
                best = found
            if agreed:
                break
        return _label(steps, [] if best is None else best.labels)

    def _revise(
        self,
        steps: Sequence[LandmarkStep],
        labels: list[IntArray],
        motion: MotionModel,
        on_progress: Callable[[], None],
    ) -> _Found:
        """Merge landmarks and assign observations again at the poses of the graph, until nothing changes."""
        graph = LandmarkGraphSlam(self.sensor, self.solver, bias=self.bias)
        solution: LandmarkGraphSolution | None = None
        best: _Found | None = None
        labels = self._leave_out_few(labels)
        for _ in range(self.rounds):
            solution = graph.solve(_label(steps, labels), motion, solution)
            cost = self._cost(labels, solution)
            if best is None or cost < best.cost:
                best = _Found(labels, solution, cost)
            before = labels
            labels = self._merge(before, solution)
            if all(np.array_equal(a, b) for a, b in zip(labels, before, strict=True)):
                calibration = self.bias.calibration(solution.systematic_errors)
                labels = self._assign(steps, solution.poses, solution.landmarks, calibration, _SMOOTHED)
            labels = self._leave_out_few(labels)
            on_progress()
            if all(np.array_equal(a, b) for a, b in zip(labels, before, strict=True)):
                break
        assert best is not None
        return best

    def _cost(self, labels: list[IntArray], solution: LandmarkGraphSolution) -> float:
        """Chi2 of the graph, and what observations of no landmark cost; a landmark costs as the fewest it may have."""
        left_out = sum(int((of_step < 0).sum()) for of_step in labels)
        of_landmarks = self.least_observations * len(solution.landmarks)
        return solution.solution.chi2_after + _OUTLIER_COST * (left_out + of_landmarks)

    def _calibrate(self, steps: Sequence[LandmarkStep], errors: FloatArray) -> list[LandmarkStep]:
        """Steps without the systematic errors (B,), and without correspondences."""
        here = np.zeros(3)
        calibration = self.bias.calibration(errors)
        calibrated = list[LandmarkStep]()
        for step in steps:
            seen = step.observations.drop_correspondences()
            if len(seen):
                points = locate_calibrated(self.sensor, here, seen.values, calibration)
                seen = replace(seen, values=self.sensor.linearize(here, points)[0])
            increment = step.increment + self.bias.by_errors(step.increment) @ errors
            calibrated.append(replace(step, increment=increment, observations=seen))
        return calibrated

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
        """Rename landmarks that are one; of two observations of one at one time the second has none."""
        names = self.merge(solution, labels)
        renamed = dict(zip(solution.landmarks.names.tolist(), names.tolist(), strict=True))
        merged = list[IntArray]()
        for of_step in labels:
            new = np.array([renamed.get(name, _NONE) for name in of_step.tolist()], np.int64)
            again = np.ones(len(new), np.bool_)
            again[np.unique(new, return_index=True)[1]] = False
            merged.append(np.where(again, _NONE, new))
        return merged

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


_OUTLIER_COST = 4.0  # what an observation adds to chi2 at most, with Cauchy's weights of scale 2
_AGREED = 0.95  # share of the observations that two starts assign alike, if they found the same landmarks
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


def _share_agreed(labels: Sequence[IntArray], others: Sequence[IntArray]) -> float:
    """Share of the observations that two results assign alike, whatever they call the landmarks."""
    a, first = np.unique(np.concatenate(labels), return_inverse=True)
    b, second = np.unique(np.concatenate(others), return_inverse=True)
    counts = np.zeros((len(a), len(b)), np.int64)
    np.add.at(counts, (first, second), 1)
    rows, columns = linear_sum_assignment(-counts)
    return float(counts[rows, columns].sum() / max(len(first), 1))
