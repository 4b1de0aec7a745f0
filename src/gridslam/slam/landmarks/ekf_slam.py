"""EKF SLAM: one Gaussian over the robot's pose and all landmarks.

It is online SLAM, p(x_t, m | z_1:t, u_1:t): each prediction integrates the pose before out, and what that pose and the
landmarks had in common stays, as correlation between the landmarks.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import lever_arm_jacobian
from gridslam.models.association import NEW, Association, KnownCorrespondence, LandmarkExistence
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing
from gridslam.models.systematic_errors import ERRORS, NO_ERRORS, SystematicErrors, linearize, locate
from gridslam.particles.initial import repeat_pose
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.types import FloatArray, IntArray, MotionSampler, OwnedState

_ROBOT = 3 + ERRORS
"""Length of the robot's part of the state: its pose and the systematic errors."""


@final
@dataclass(frozen=True)
class EkfSlam:
    """The filter: it has no state of its own; `step` takes a state and returns the next one.

    Attributes
    ----------
    sensor : LandmarkModel
        p(z | x, m) of one landmark.
    association : Association
        `KnownCorrespondence` if the observations contain the correspondences, `MaximumLikelihood` otherwise.
    existence : LandmarkExistence
        Which landmarks are real, where correspondences are unknown. A provisional one learns from the robot's pose,
        but the pose learns nothing from it.
    bias : SystematicErrors
        Systematic errors of odometry and sensor, which are part of the state.

    References
    ----------
    Probabilistic Robotics, Tables 10.1 (known correspondences) and 10.2 (unknown). The tables correct by one
    observation after the other; here all observations of a step are used at once: the same for a linear model, and one
    update of the covariance, whose cost grows with the square of the number of landmarks, instead of many.

    Jacobians are taken at first estimates: at the poses as predicted, and at the landmarks as they were first put. At
    the newest ones a filter gains information about the heading that no measurement contains, and its covariance falls
    below its error: G. Huang, A. Mourikis, S. Roumeliotis, Observability-based rules for designing consistent EKF SLAM
    estimators, IJRR 2010.
    """

    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)
    existence: LandmarkExistence = field(default_factory=LandmarkExistence)
    bias: SystematicErrors = NO_ERRORS

    def init(self, pose: ArrayLike = (0.0, 0.0, 0.0)) -> EkfSlamState:
        """Begin at a pose (3,) that is exact, without landmarks."""
        return EkfSlamState.at(pose, self.bias.covariance())

    def step(
        self, state: EkfSlamState, motion: MotionSampler, observations: LandmarkObservations
    ) -> tuple[EkfSlamState, LandmarkReport]:
        """Take one step; consumes `state` (keep one for later with `state.snapshot()`).

        Parameters
        ----------
        state : EkfSlamState
        motion : MotionSampler
            The motion model, conditioned on u_t.
        observations : LandmarkObservations
            z_t, with c_t where the association needs it; perhaps none.

        Raises
        ------
        ArgumentError
            The association needs correspondences that the observations do not contain.
        """
        state = state.take()
        self.predict(state, motion)
        residuals, S = self.predict_observations(state, observations)  # Table 10.2, lines 9 to 16: correspondences
        places = self.association(observations, state.names, *mahalanobis(residuals, S))
        return state, self.update(state, observations, places)

    def update(self, state: EkfSlamState, observations: LandmarkObservations, places: IntArray) -> LandmarkReport:
        """Correct a predicted state, in place, by observations of landmarks `places` (K,); returns the report."""
        places = places.copy()
        noise = self.sensor.noise(observations)
        known = np.flatnonzero(places >= 0)
        confirmed = state.evidence[places[known]] >= self.existence.log_odds_confirmed
        used = known[confirmed]
        self._correct(state, places[used], observations.values[used], noise[used])
        for k in known[~confirmed].tolist():
            self._correct_provisional(state, int(places[k]), observations.values[k], noise[k])
        for k in np.flatnonzero(places == NEW).tolist():
            places[k] = self._add(state, observations, k, noise[k])
        reported = places.copy()
        reported[places >= 0] = state.names[places[places >= 0]]
        self._count(state, places[places >= 0], observations)
        return LandmarkReport(state.pose.copy(), state.pose_covariance.copy(), reported)

    def landmark_map(self, state: EkfSlamState) -> LandmarkMap:
        """Return the confirmed landmarks."""
        kept = state.evidence >= self.existence.log_odds_confirmed
        covariances = state.position_covariances[kept]
        return LandmarkMap(state.names[kept], state.positions[kept], covariances, state.observations[kept])

    def predict(self, state: EkfSlamState, motion: MotionSampler) -> None:
        """Tables 10.1 and 10.2, lines 2 to 5, in place: the pose moves."""
        P = state.covariance
        robot = slice(_ROBOT)
        moved, G, R = self.bias.predict(motion, state.mean[robot])
        G[:3, :3] = lever_arm_jacobian(state.predicted, moved)
        state.mean[robot] = moved
        state.predicted = moved[:3].copy()
        P[robot] = G @ P[robot]
        P[:, robot] = P[:, robot] @ G.T
        P[robot, robot] += R

    def predict_observations(
        self, state: EkfSlamState, observations: LandmarkObservations
    ) -> tuple[FloatArray, FloatArray]:
        """Innovations (K, M, 2) of K observations, if they are of each of M landmarks, and covariances of them."""
        predicted, H_x, H_m = self._linearize(state, np.arange(len(state.names)))
        H = np.concatenate([H_x, H_m], axis=-1)
        P = np.empty((len(state.names), _ROBOT + 2, _ROBOT + 2))  # of the robot and each landmark
        P[:, :_ROBOT, :_ROBOT] = state.covariance[:_ROBOT, :_ROBOT]
        P[:, _ROBOT:, _ROBOT:] = state.position_covariances
        P[:, :_ROBOT, _ROBOT:] = state.covariance[:_ROBOT, _ROBOT:].reshape(_ROBOT, -1, 2).swapaxes(0, 1)
        P[:, _ROBOT:, :_ROBOT] = P[:, :_ROBOT, _ROBOT:].swapaxes(1, 2)
        residuals = self.sensor.residual(observations.values[:, None], predicted)
        return residuals, H @ P @ H.swapaxes(1, 2) + self.sensor.noise(observations)[:, None]

    def _correct(self, state: EkfSlamState, places: IntArray, measured: FloatArray, noise: FloatArray) -> None:
        """Table 10.1, lines 12 to 20, for K observations: P - K S K' = P - W' W with W = L^-1 H P, S = L L'."""
        if not len(places):
            return
        residuals, HP, S = self.innovation(state, places, measured, noise)
        L = np.linalg.cholesky(S)
        W = np.linalg.solve(L, HP)
        state.mean += np.linalg.solve(L, residuals) @ W
        state.mean[2] = wrap(float(state.mean[2]))
        state.covariance -= W.T @ W

    def _correct_provisional(self, state: EkfSlamState, place: int, measured: FloatArray, noise: FloatArray) -> None:
        """Correct one landmark alone: the gain of all else is 0 (Schmidt's consider filter)."""
        residual, HP, S = self.innovation(state, np.array([place]), measured[None], noise[None])
        own = slice(_ROBOT + 2 * place, _ROBOT + 2 * place + 2)
        gain = np.linalg.solve(S, HP[:, own]).T
        state.mean[own] += gain @ residual
        state.covariance[own] -= gain @ HP
        state.covariance[:, own] = state.covariance[own].T

    def innovation(
        self, state: EkfSlamState, places: IntArray, measured: FloatArray, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (2 K,), H P (2 K, n) and S = H P H' + Q (2 K, 2 K), of the few columns where H is not 0."""
        predicted, H_x, H_m = self._linearize(state, places)
        count = len(places)
        P = state.covariance
        columns = _ROBOT + 2 * places[:, None] + np.arange(2)
        HP = H_x @ P[:_ROBOT] + H_m @ P[columns]
        S = np.einsum("iac,jbc->iajb", HP[:, :, :_ROBOT], H_x) + np.einsum("iajc,jbc->iajb", HP[:, :, columns], H_m)
        S[np.arange(count), :, np.arange(count)] += noise
        residuals = self.sensor.residual(measured, predicted)
        return residuals.ravel(), HP.reshape(2 * count, len(P)), S.reshape(2 * count, 2 * count)

    def _linearize(self, state: EkfSlamState, places: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """h (K, 2) of landmarks `places` (K,), and its Jacobians by robot (K, 2, 8) and by landmark (K, 2, 2).

        Jacobians are those of the first estimates: see `EkfSlam`.
        """
        predicted, _ = linearize(self.sensor, state.mean[:_ROBOT], state.positions[places])
        _, H_x = linearize(self.sensor, np.append(state.predicted, state.errors), state.first_positions[places])
        return predicted, H_x, -H_x[..., :2]  # only where a landmark is relative to the robot makes a difference

    def _add(self, state: EkfSlamState, observations: LandmarkObservations, k: int, noise: FloatArray) -> int:
        """Tables 10.1, lines 9 to 11, and 10.2, line 8: put a landmark where it is seen.

        z = h(x, m) + e makes dm = H_m^-1 (dz - H_x dx - e).
        """
        position = locate(self.sensor, state.mean[:_ROBOT], observations.values[k])
        _, (H_x,) = linearize(self.sensor, np.append(state.predicted, state.errors), position[None])
        by_measured = np.linalg.inv(-H_x[:, :2])
        by_pose = -by_measured @ H_x
        with_others = by_pose @ state.covariance[:_ROBOT]
        own = with_others[:, :_ROBOT] @ by_pose.T + by_measured @ noise @ by_measured.T
        if self.association.uses_signatures and observations.landmarks is not None:
            name = int(observations.landmarks[k])
        else:
            name = state.next_name
            state.next_name += 1
        state.append(name, position, with_others, own)
        return len(state.names) - 1

    def _count(self, state: EkfSlamState, places: IntArray, observations: LandmarkObservations) -> None:
        """Count observations and update the evidence; drop landmarks whose evidence is negative."""
        state.observations[places] += 1
        if self.association.uses_signatures:
            state.evidence[places] = math.inf
        elif len(observations):  # a sensor that sees nothing may not have looked
            seen = np.zeros(len(state.names), np.bool_)
            seen[places] = True
            state.evidence = self.existence(state.evidence, seen, state.pose, state.positions)
            if (state.evidence < 0).any():
                state.keep(state.evidence >= 0)


@final
@dataclass(slots=True, eq=False)
class EkfSlamState(OwnedState):
    """Everything that the filter knows between two steps; it has one owner, who changes it.

    Attributes
    ----------
    mean, covariance : (8 + 2 M,), (8 + 2 M, 8 + 2 M) float64
        Of [x, y, theta, b, m_1x, m_1y, m_2x, ...], in m and rad, map frame, b being the five systematic errors.
    predicted : (3,) float64
        The last pose before its correction.
    first_positions : (M, 2) float64, m
        Where each landmark was put when it was first seen.
    names : (M,) int64
        Signatures of the landmarks, or numbers in the order of first sight.
    evidence : (M,) float64, nats
        Log odds that each exists; infinite where its signature is known.
    observations : (M,) int64
        How often each was seen.
    next_name : int
        Number of the next landmark without a signature.
    """

    mean: FloatArray
    covariance: FloatArray
    predicted: FloatArray
    first_positions: FloatArray
    names: IntArray
    evidence: FloatArray
    observations: IntArray
    next_name: int = 0

    @classmethod
    def at(cls, pose: ArrayLike, errors: FloatArray) -> EkfSlamState:
        """Begin at a pose (3,) that is exact, with errors of covariance (5, 5); ArgumentError where it is no pose."""
        mean = np.append(repeat_pose(1, pose)[0], np.zeros(ERRORS))
        nothing = np.empty(0, np.int64)
        covariance = np.zeros((_ROBOT, _ROBOT))
        covariance[3:, 3:] = errors
        return cls(mean, covariance, mean[:3].copy(), np.empty((0, 2)), nothing, np.empty(0), nothing)

    @property
    def pose(self) -> FloatArray:
        """Mean pose (3,)."""
        return self.mean[:3]

    @property
    def pose_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose."""
        return self.covariance[:3, :3]

    @property
    def errors(self) -> FloatArray:
        """Means (5,) of the systematic errors."""
        return self.mean[3:_ROBOT]

    @property
    def positions(self) -> FloatArray:
        """Mean positions (M, 2) of the landmarks."""
        return self.mean[_ROBOT:].reshape(-1, 2)

    @property
    def position_covariances(self) -> FloatArray:
        """Covariance (M, 2, 2) of each landmark's position."""
        every = np.arange(len(self.names))
        return np.asarray(self.covariance[_ROBOT:, _ROBOT:].reshape(len(every), 2, len(every), 2)[every, :, every])

    def append(self, name: int, position: FloatArray, with_others: FloatArray, own: FloatArray) -> None:
        """Add a landmark at the end.

        Parameters
        ----------
        name : int
        position : (2,) float64
        with_others : (2, n) float64
            Its covariance with all that is in the state.
        own : (2, 2) float64
            Its own covariance.
        """
        self.mean = np.concatenate([self.mean, position])
        self.covariance = np.block([[self.covariance, with_others.T], [with_others, own]])
        self.first_positions = np.vstack([self.first_positions, position])
        self.names = np.append(self.names, name)
        self.evidence = np.append(self.evidence, 0.0)
        self.observations = np.append(self.observations, 0)

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Forget all landmarks but those `kept` (M,)."""
        rows = np.flatnonzero(np.concatenate([np.ones(_ROBOT, np.bool_), np.repeat(kept, 2)]))
        self.mean = self.mean[rows]
        self.covariance = self.covariance[np.ix_(rows, rows)]
        for name in ("first_positions", "names", "evidence", "observations"):
            setattr(self, name, getattr(self, name)[kept])

    def snapshot(self) -> EkfSlamState:
        """Return an independent copy for later."""
        self.require_owned()
        return deepcopy(self)
