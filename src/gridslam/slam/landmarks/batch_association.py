"""Correspondences of a whole log: by a particle filter, revised once at poses that know the whole log.

A filter decides when an observation comes. Where the log is complete it can be asked again: at the poses of GraphSLAM
with the correspondences so far, which later observations have corrected, each observation has a nearest landmark.
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
)
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.landmarks.particles import smooth_trajectory
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import CauchyEstimator
from gridslam.types import FloatArray, IntArray, MotionModel

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
    smoothing : MotionModel or None
        For increments without covariance, when the correspondences are revised. None takes the filter's.
    gate : float
        Greatest squared Mahalanobis distance of an observation, at the smoothed pose, from its landmark.
    least_observations : int
        A landmark of fewer observations is none.
    particles : int
        Of the filter. After an interval without observations the first one may be of any of several landmarks in any of
        several directions, and some particles must be right: of MRCLAM's intervals of 30 s, in a room of 15 barcodes,
        20 particles seldom survive all.
    solver : GraphSlam
        For the smoothed poses.
    """

    slam: FastSlam2
    sensor: LandmarkModel
    bias: SystematicErrors
    smoothing: MotionModel | None = None
    gate: float = 16.0
    least_observations: int = 3
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
            Called after each step of the filter, and after the revision.
        """
        labels = self._leave_out_few(self._filter(steps, motion, rng, on_progress))
        found = _label(steps, labels)
        graph = LandmarkGraphSlam(self.sensor, self.solver, bias=self.bias).solve(found, self.smoothing or motion)
        calibration = self.bias.calibration(graph.systematic_errors)
        landmarks = self._drop_copies(labels, graph.landmarks)
        labels = self._assign(steps, graph.poses, landmarks, calibration, _SMOOTHED)
        on_progress()
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

    def _drop_copies(self, labels: Sequence[IntArray], landmarks: LandmarkMap) -> LandmarkMap:
        """Drop the rarer of two landmarks at one place, the nearest pair first; two that are seen together are two."""
        seen = np.array([np.isin(landmarks.names, of_step) for of_step in labels], np.int64)
        counts = seen.T @ seen
        rarer = np.minimum(np.diag(counts)[:, None], np.diag(counts))
        i, j = np.nonzero(np.triu(counts <= _TOGETHER * rarer, 1))
        covariances = landmarks.covariances[i] + landmarks.covariances[j]
        squared, _ = mahalanobis(landmarks.positions[i] - landmarks.positions[j], covariances)
        left = set(range(len(landmarks)))
        paired = set[int]()
        for k in np.argsort(squared, kind="stable")[: np.count_nonzero(squared < self.gate)].tolist():
            pair = {int(i[k]), int(j[k])}
            if not pair & paired:
                paired |= pair
                left.remove(min(pair, key=lambda one: counts[one, one]))
        kept = sorted(left)
        names, observations = landmarks.names[kept], landmarks.observations[kept]
        return LandmarkMap(names, landmarks.positions[kept], landmarks.covariances[kept], observations)

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


_TOGETHER = 0.1  # share of the observations of the rarer of two copies that may come with the other, wrongly
_SMOOTHED = np.diag([0.05**2, 0.015**2])
"""Covariance of an observation by the error of a smoothed pose: m and rad."""
_FILTERED = 4 * _SMOOTHED
"""The same of a filter's pose."""


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
