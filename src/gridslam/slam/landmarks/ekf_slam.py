"""EKF SLAM: one Gaussian over the robot's pose and all landmarks.

It is online SLAM, p(x_t, m | z_1:t, u_1:t): each prediction integrates the pose before out, and what that pose and the
landmarks had in common stays, as correlation between the landmarks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.geometry.angles import wrap
from gridslam.models.association import NEW, Association, KnownCorrespondence
from gridslam.models.landmark import LandmarkModel, RangeBearing
from gridslam.models.landmark_observations import LandmarkObservations
from gridslam.models.odometry_bias import EXACT_ODOMETRY, OdometryBias
from gridslam.slam.landmarks.ekf_slam_state import EkfSlamState
from gridslam.slam.landmarks.existence import LandmarkExistence
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.slam.landmarks.small_gaussians import mahalanobis
from gridslam.types import FloatArray, IntArray, MotionSampler

__all__ = ["EkfSlam"]


@final
@dataclass(frozen=True)
class EkfSlam:
    """The filter; what it knows is in the state that goes in and comes out of `step`.

    Attributes
    ----------
    sensor : LandmarkModel
        p(z | x, m) of one landmark.
    association : Association
        `KnownCorrespondence` if the observations contain the correspondences, `MaximumLikelihood` otherwise.
    existence : LandmarkExistence
        Which landmarks are real, where correspondences are unknown. A provisional one learns from the robot's pose,
        but the pose learns nothing from it.
    bias : OdometryBias
        Systematic errors of the odometry, which are part of what is estimated.

    Source: Probabilistic Robotics, Tables 10.1 (known correspondences) and 10.2 (unknown). The tables correct by one
    observation after the other; here all observations of a step are used at once: the same for a linear model, and one
    update of the covariance, whose cost grows with the square of the number of landmarks, instead of many.
    """

    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)
    existence: LandmarkExistence = field(default_factory=LandmarkExistence)
    bias: OdometryBias = EXACT_ODOMETRY

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
        state, noise = state.take(), self.sensor.noise(observations)
        self._predict(state, motion)
        places = self._correspondences(state, observations, noise)
        known = np.flatnonzero(places >= 0)
        confirmed = state.evidence[places[known]] >= self.existence.log_odds_confirmed
        self._correct(state, places[known[confirmed]], observations.values[known[confirmed]], noise[known[confirmed]])
        for k in known[~confirmed].tolist():
            self._correct_provisional(state, int(places[k]), observations.values[k], noise[k])
        for k in np.flatnonzero(places == NEW).tolist():
            places[k] = self._add(state, observations, k, noise[k])
        told = places.copy()
        told[places >= 0] = state.names[places[places >= 0]]
        self._count(state, places[places >= 0], observations)
        return state, LandmarkReport(state.pose.copy(), state.pose_covariance.copy(), told)

    def landmark_map(self, state: EkfSlamState) -> LandmarkMap:
        """Return the confirmed landmarks."""
        return state.landmark_map(self.existence.log_odds_confirmed)

    def _predict(self, state: EkfSlamState, motion: MotionSampler) -> None:
        """Tables 10.1 and 10.2, lines 2 to 5: only the pose moves, and the odometry's errors with it."""
        own, P = slice(state.first), state.covariance
        (moved,), (F,), (Q,) = self.bias.predict(motion, state.mean[None, own])
        state.mean[own] = moved
        P[own] = F @ P[own]
        P[:, own] = P[:, own] @ F.T
        P[own, own] += Q

    def _correspondences(self, state: EkfSlamState, observations: LandmarkObservations, noise: FloatArray) -> IntArray:
        """Table 10.2, lines 9 to 16: the index of each observation's landmark in the state."""
        predicted, H_x, H_m = self.sensor.linearize(state.pose, state.positions)
        H = np.concatenate([H_x, H_m], axis=-1)
        P = np.empty((len(state.names), 5, 5))  # of the pose and each landmark
        P[:, :3, :3], P[:, 3:, 3:] = state.pose_covariance, state.position_covariances
        P[:, :3, 3:] = state.covariance[:3, state.first :].reshape(3, -1, 2).swapaxes(0, 1)
        P[:, 3:, :3] = P[:, :3, 3:].swapaxes(1, 2)
        residuals = self.sensor.residual(observations.values[:, None], predicted)
        S = H @ P @ H.swapaxes(1, 2) + noise[:, None]
        return self.association(observations, state.names, *mahalanobis(residuals, S))

    def _correct(self, state: EkfSlamState, places: IntArray, measured: FloatArray, noise: FloatArray) -> None:
        """Table 10.1, lines 12 to 20, for K observations: P - K S K' = P - W' W with W = L^-1 H P, S = L L'."""
        if not len(places):
            return
        residuals, HP, S = self._innovation(state, places, measured, noise)
        W = np.linalg.solve(L := np.linalg.cholesky(S), HP)
        state.mean += np.linalg.solve(L, residuals) @ W
        state.mean[2] = wrap(float(state.mean[2]))
        state.covariance -= W.T @ W

    def _correct_provisional(self, state: EkfSlamState, place: int, measured: FloatArray, noise: FloatArray) -> None:
        """Correct one landmark alone: the gain of all else is 0 (Schmidt's consider filter)."""
        residual, HP, S = self._innovation(state, np.array([place]), measured[None], noise[None])
        own = slice(state.first + 2 * place, state.first + 2 * place + 2)
        gain = np.linalg.solve(S, HP[:, own]).T
        state.mean[own] += gain @ residual
        state.covariance[own] -= gain @ HP
        state.covariance[:, own] = state.covariance[own].T

    def _innovation(
        self, state: EkfSlamState, places: IntArray, measured: FloatArray, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (2 K,), H P (2 K, n) and S = H P H' + Q (2 K, 2 K), of the few columns where H is not 0."""
        predicted, H_x, H_m = self.sensor.linearize(state.pose, state.positions[places])
        P, count = state.covariance, len(places)
        columns = state.first + 2 * places[:, None] + np.arange(2)
        HP = H_x @ P[:3] + H_m @ P[columns]
        S = np.einsum("iac,jbc->iajb", HP[:, :, :3], H_x) + np.einsum("iajc,jbc->iajb", HP[:, :, columns], H_m)
        S[np.arange(count), :, np.arange(count)] += noise
        residuals = self.sensor.residual(measured, predicted)
        return residuals.ravel(), HP.reshape(2 * count, -1), S.reshape(2 * count, 2 * count)

    def _add(self, state: EkfSlamState, observations: LandmarkObservations, k: int, noise: FloatArray) -> int:
        """Tables 10.1, lines 9 to 11, and 10.2, line 8: put a landmark where it is seen.

        z = h(x, m) + e makes dm = H_m^-1 (dz - H_x dx - e).
        """
        position = self.sensor.locate(state.pose, observations.values[k])
        _, H_x, H_m = self.sensor.linearize(state.pose, position)
        by_measured = np.linalg.inv(H_m)
        by_pose = -by_measured @ H_x
        with_others = by_pose @ state.covariance[:3]
        own = with_others[:, :3] @ by_pose.T + by_measured @ noise @ by_measured.T
        if self.association.uses_signatures and observations.landmarks is not None:
            name = int(observations.landmarks[k])
        else:
            name, state.next_name = state.next_name, state.next_name + 1
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
