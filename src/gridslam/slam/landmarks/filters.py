"""Base of FastSLAM 1.0 and 2.0: correspondences and landmarks of each particle, for all particles at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels import backend
from gridslam.kernels.reference_landmarks import DEPTH_BEARING, RANGE_BEARING, RELATIVE_POSITION
from gridslam.models.association import (
    AMBIGUOUS,
    NEW,
    Association,
    KnownCorrespondence,
    LandmarkExistence,
    MaximumLikelihood,
    signatures,
)
from gridslam.models.landmark import (
    DepthBearing,
    LandmarkModel,
    LandmarkObservations,
    RangeBearing,
    RelativePosition,
    linearize_calibrated,
    locate_calibrated,
)
from gridslam.models.systematic_errors import NO_ERRORS, SystematicErrors
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.slam.landmarks.small_gaussians import (
    inverse_2x2,
    log_density,
    mahalanobis,
    transform_covariances,
)
from gridslam.types import FloatArray, IntArray

# Sensors whose predictions a kernel computes; any other one is asked for its own.
_KINDS: dict[type, int] = {
    RangeBearing: RANGE_BEARING,
    DepthBearing: DEPTH_BEARING,
    RelativePosition: RELATIVE_POSITION,
}
_MOST_CANDIDATES = 64
"""Of an observation in a particle: one that may be of any of hundreds of landmarks contains nothing about them.

Of Victoria Park's observations the most are 23, of MRCLAM's 17. Where all landmarks are candidates, as in a log of huge
covariances, the time would grow with the square of the observations.
"""
_EXACT, _NO_CALIBRATION = np.empty((0, 3, 3)), np.empty((0, 2))


class PoseBelief(Protocol):
    """The poses from which landmarks are observed: sampled ones, or a Gaussian in each particle."""

    @property
    def poses(self) -> FloatArray:
        """Poses (N, 3), or their means."""
        ...

    @property
    def calibration(self) -> FloatArray:
        """Mounting and scale (N, 2) of the sensor in each particle, see `linearize_calibrated`."""
        ...

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray | None:
        """Covariance (R, 3, 3) of the poses as seen from landmarks (rows, columns); None where they are sampled."""

    def bound_covariance(self) -> FloatArray | None:
        """Upper bound (N, 3, 3) of the pose covariance relative to any landmark; None where they are sampled."""


@dataclass(frozen=True, eq=False)
class SampledPoses:
    """Poses (N, 3) that are sampled: each particle takes its own for exact; and the calibration (N, 2) of each."""

    poses: FloatArray
    calibration: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        """Take a sensor without systematic errors where no calibration is given."""
        if not len(self.calibration):
            object.__setattr__(self, "calibration", np.zeros((len(self.poses), 2)))

    def covariance_seen_from(self, rows: IntArray, columns: IntArray) -> FloatArray | None:
        """Return None: there is no covariance."""
        return None

    def bound_covariance(self) -> None:
        """Return None: there is no covariance."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """One observation, as predicted by some of the particles.

    Attributes
    ----------
    rows, columns : (R,) int64
        Which landmark of which particle.
    residuals, covariances : (R, 2), (R, 2, 2) float64
        Measured minus predicted, and what it is expected to vary by.
    by_pose, by_landmark, by_errors : (R, 2, 3), (R, 2, 2), (R, 2, B) float64
        Jacobians of the prediction, the last by the systematic errors.
    """

    rows: IntArray
    columns: IntArray
    residuals: FloatArray
    covariances: FloatArray
    by_pose: FloatArray
    by_landmark: FloatArray
    by_errors: FloatArray

    def select(self, chosen: NDArray[np.bool_]) -> Innovation:
        """Return those that are chosen (R,)."""
        if chosen.all():
            return self
        return Innovation(
            self.rows[chosen],
            self.columns[chosen],
            self.residuals[chosen],
            self.covariances[chosen],
            self.by_pose[chosen],
            self.by_landmark[chosen],
            self.by_errors[chosen],
        )


@final
@dataclass(frozen=True)
class LandmarkFilters:
    """Given its path, each particle's landmarks are independent: an extended Kalman filter for each of them.

    Attributes
    ----------
    sensor : LandmarkModel
        p(z | x, m) of one landmark.
    association : Association
        `KnownCorrespondence` if the observations contain the correspondences, `MaximumLikelihood` otherwise: then each
        particle estimates its own.
    existence : LandmarkExistence
        Which landmarks are real, where correspondences are unknown.
    bias : SystematicErrors
        Those of the sensor that the particles learn.
    """

    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)
    existence: LandmarkExistence = field(default_factory=LandmarkExistence)
    bias: SystematicErrors = NO_ERRORS

    def order(self, state: LandmarkParticles, observations: LandmarkObservations, belief: PoseBelief) -> IntArray:
        """Order (K,) of association: most certain first, by the best particle.

        So one of two landmarks side by side is not taken for the other if that is seen, too.
        """
        if self.association.uses_signatures or len(observations) < 2:
            return np.arange(len(observations))
        best = state.best
        known = state.exists[best]
        predicted, _, H_m, _ = linearize_calibrated(
            self.sensor, belief.poses[best], state.positions[best, known], belief.calibration[best]
        )
        L = transform_covariances(H_m, state.covariances[best, known]) + self.sensor.noise(observations)[:, None]
        squared, log_dets = mahalanobis(self.sensor.residual(observations.values[:, None], predicted), L)
        return np.argsort((squared + log_dets).min(axis=1, initial=math.inf), kind="stable")

    def correspond(
        self,
        state: LandmarkParticles,
        observations: LandmarkObservations,
        k: int,
        belief: PoseBelief,
        taken: IntArray,
        rng: np.random.Generator,
    ) -> tuple[IntArray, FloatArray, Innovation]:
        """Associate observation k with a landmark in each particle.

        Parameters
        ----------
        belief : PoseBelief
            The poses of the observation.
        taken : (N, K) int64
            Columns of the observations before, below 0 where there is none: a landmark is observed once per step.
        rng : numpy.random.Generator
            Unknown correspondences are sampled.

        Returns
        -------
        columns : (N,) int64
            Of the landmark, or `NEW`, or `AMBIGUOUS`.
        log_likelihoods : (N,) float64, nats
            log p(z); for particles that know no landmark for it, that of the threshold.
        seen : Innovation
            What the particles predict that know a landmark.
        """
        if isinstance(self.association, MaximumLikelihood):
            return self._draw_correspondences(state, observations, k, belief, taken, self.association, rng)
        column = state.column(int(signatures(observations)[k]))
        if column == NEW:
            nobody = np.empty(0, np.int64)
            none = self.innovation(state, nobody, nobody, belief, observations, k)
            return np.full(len(state), NEW), np.full(len(state), self._log_threshold(observations, k)), none
        rows = np.arange(len(state))
        seen = self.innovation(state, rows, np.full(len(rows), column), belief, observations, k)
        squared, log_dets = mahalanobis(seen.residuals, seen.covariances)
        believed = squared <= self.association.gate
        likelihood = log_density(np.minimum(squared, self.association.gate), log_dets)
        return np.where(believed, column, AMBIGUOUS), likelihood, seen.select(believed)

    def innovation(
        self,
        state: LandmarkParticles,
        rows: IntArray,
        columns: IntArray,
        belief: PoseBelief,
        observations: LandmarkObservations,
        k: int,
    ) -> Innovation:
        """Predict observation k of R landmarks (rows, columns): h, H_x, H_m, and H_m Sigma H_m' + Q + H_x R H_x'."""
        R = belief.covariance_seen_from(rows, columns)
        Q = self.sensor.noise(observations)[k]
        kind = _KINDS.get(type(self.sensor))
        learned = state.pose_by_bias.size > 0
        if kind is not None:
            residuals, L, H_x, H_m, H_c = backend.predict_landmarks(
                kind,
                belief.poses,
                belief.calibration if learned else _NO_CALIBRATION,
                state.positions,
                state.covariances,
                rows,
                columns,
                _EXACT if R is None else R,
                observations.values[k],
                Q,
            )
        else:
            predicted, H_x, H_m, H_c = linearize_calibrated(
                self.sensor, belief.poses[rows], state.positions[rows, columns], belief.calibration[rows]
            )
            L = transform_covariances(H_m, state.covariances[rows, columns]) + Q
            if R is not None:
                L += transform_covariances(H_x, R)
            residuals = self.sensor.residual(observations.values[k], predicted)
        by_errors = self.bias.by_calibration(H_c) if learned else H_x[..., :0]
        return Innovation(rows, columns, residuals, L, H_x, H_m, by_errors)

    def correct(self, state: LandmarkParticles, seen: Innovation) -> None:
        """Correct the observed landmarks, given the poses.

        Source: Probabilistic Robotics, Tables 13.1 and 13.2 (mean and covariance of the features).
        """
        places = seen.rows * state.positions.shape[1] + seen.columns
        means, covariances = state.positions.reshape(-1, 2), state.covariances.reshape(-1, 2, 2)
        _, gain = backend.kalman_update(means, covariances, places, seen.by_landmark, seen.covariances, seen.residuals)
        if state.pose_by_bias.size:
            directly = seen.by_pose @ state.pose_by_bias[seen.rows] + seen.by_errors
            of = seen.rows, seen.columns
            state.positions_by_bias[of] -= gain @ (directly + seen.by_landmark @ state.positions_by_bias[of])

    def add(
        self,
        state: LandmarkParticles,
        columns: IntArray,
        belief: PoseBelief,
        observations: LandmarkObservations,
        k: int,
    ) -> None:
        """Add a landmark at observation k to particles whose columns (N,) are `NEW`, and write its column there.

        Source: Probabilistic Robotics, Tables 13.1 and 13.2: mean h^-1(z, x), covariance H^-1 Q H^-1'.
        """
        rows = np.flatnonzero(columns == NEW)
        if not len(rows):
            return
        name = int(signatures(observations)[k]) if self.association.uses_signatures else None
        columns[rows] = state.new_columns(rows, name)
        of = rows, columns[rows]
        c = belief.calibration[rows]
        state.positions[of] = locate_calibrated(self.sensor, belief.poses[rows], observations.values[k], c)
        _, H_x, H_m, H_c = linearize_calibrated(self.sensor, belief.poses[rows], state.positions[of], c)
        root = inverse_2x2(H_m)
        if state.pose_by_bias.size:
            by_errors = H_x @ state.pose_by_bias[rows] + self.bias.by_calibration(H_c)
            state.positions_by_bias[of] = -root @ by_errors
        state.covariances[of] = transform_covariances(
            root, np.broadcast_to(self.sensor.noise(observations)[k], root.shape)
        )
        known = self.association.uses_signatures
        state.evidence[of] = math.inf if known else 0.0
        state.confirmed[of] = known
        state.observations[of] = 0

    def count(self, state: LandmarkParticles, columns: IntArray) -> None:
        """Count the observations of landmarks `columns` (N, K), update the evidence of all, and drop refuted ones.

        Source: Probabilistic Robotics, Table 13.2 (the counters i), as log odds.
        """
        count, width = state.observations.shape
        places = (columns + width * np.arange(count)[:, None])[columns >= 0]
        state.observations.reshape(-1)[places] += 1
        if columns.shape[1] and not self.association.uses_signatures:  # a sensor that sees nothing may not have looked
            seen = np.zeros(state.evidence.shape, np.bool_)
            seen.reshape(-1)[places] = True
            evidence = self.existence(state.evidence, seen, state.poses[:, None], state.positions)
            state.evidence = np.where(evidence < 0, -math.inf, evidence)
            state.confirmed = (state.confirmed | (evidence >= self.existence.log_odds_confirmed)) & (evidence >= 0)

    def _log_threshold(self, observations: LandmarkObservations, k: int) -> float:
        """log p_0, the density at the threshold beyond which an observation is of no known landmark."""
        log_det = np.log(np.linalg.det(self.sensor.noise(observations)[k]))
        return float(log_density(self.association.outlier_distance, log_det))

    def _draw_correspondences(
        self,
        state: LandmarkParticles,
        observations: LandmarkObservations,
        k: int,
        belief: PoseBelief,
        taken: IntArray,
        within: MaximumLikelihood,
        rng: np.random.Generator,
    ) -> tuple[IntArray, FloatArray, Innovation]:
        """Sample c ~ p(c | z), so that particles hold different correspondences; the weight is the sum of p(z | c)."""
        rows, columns = np.nonzero(self._may_match(state, observations, k, belief, within.new_gate))
        seen = self.innovation(state, rows, columns, belief, observations, k)
        squared, log_dets = mahalanobis(seen.residuals, seen.covariances)
        free = (taken[rows] != columns[:, None]).all(axis=1)
        near = np.zeros(len(state), np.bool_)
        near[rows[free & (squared <= within.new_gate)]] = True
        log_p = np.full((len(state), 1 + len(state.names)), -math.inf)
        log_p[:, 0] = self._log_threshold(observations, k)
        log_p[rows[free], 1 + columns[free]] = log_density(squared[free], log_dets[free])
        likelihood = np.logaddexp.reduce(log_p, axis=1)
        possible = log_p > -math.inf
        log_p[possible] += rng.gumbel(size=int(possible.sum()))  # the greatest is then a draw
        drawn = log_p.argmax(axis=1) - 1  # NEW is -1
        drawn[(drawn == NEW) & near] = AMBIGUOUS
        chosen = drawn[rows] == columns
        drawn[rows[chosen & (squared > within.match_gate)]] = AMBIGUOUS
        return drawn, likelihood, seen.select(chosen & (squared <= within.match_gate))

    def _may_match(
        self, state: LandmarkParticles, observations: LandmarkObservations, k: int, belief: PoseBelief, distance: float
    ) -> NDArray[np.bool_]:
        """Which landmarks (N, M) may be within a squared Mahalanobis distance, by bounds that cost little.

        In each particle they are the nearest `_MOST_CANDIDATES` at most.
        """
        at = locate_calibrated(self.sensor, belief.poses, observations.values[k], belief.calibration)
        _, H_x, H_m, _ = linearize_calibrated(self.sensor, belief.poses, at, belief.calibration)
        L = self.sensor.noise(observations)[k]
        if (bound := belief.bound_covariance()) is not None:
            L = L + transform_covariances(H_x, bound)
        reach = np.trace(transform_covariances(inverse_2x2(H_m), np.broadcast_to(L, H_m.shape)), axis1=1, axis2=2)
        reach = reach[:, None] + state.covariances[..., 0, 0] + state.covariances[..., 1, 1]
        x, y = (state.positions[..., i] - at[:, None, i] for i in (0, 1))
        away = x * x + y * y
        near: NDArray[np.bool_] = state.exists & (away <= distance * reach)
        crowded = np.flatnonzero(near.sum(axis=1) > _MOST_CANDIDATES)
        if len(crowded):
            nearness = np.where(near[crowded], away[crowded] / reach[crowded], math.inf)
            near[crowded] &= nearness <= np.partition(nearness, _MOST_CANDIDATES - 1, axis=1)[:, [_MOST_CANDIDATES - 1]]
        return near
