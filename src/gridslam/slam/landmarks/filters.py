"""Base of FastSLAM 1.0 and 2.0: correspondences and landmarks of each particle, for all particles at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.models.association import (
    AMBIGUOUS,
    NEW,
    Association,
    KnownCorrespondence,
    LandmarkExistence,
    MaximumLikelihood,
    signatures,
)
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing
from gridslam.slam.landmarks.particles import LandmarkParticles, PoseBelief
from gridslam.slam.landmarks.small_gaussians import (
    inverse_2x2,
    kalman_update,
    log_density,
    mahalanobis,
    transform_covariances,
)
from gridslam.types import FloatArray, IntArray

_MOST_CANDIDATES = 64
"""Of an observation in a particle: one that may be of any of hundreds of landmarks contains nothing about them.

Of Victoria Park's observations the most are 23, of MRCLAM's 17. Where all landmarks are candidates, as in a log of huge
covariances, the time would grow with the square of the observations.
"""


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
    by_pose, by_landmark : (R, 2, 3), (R, 2, 2) float64
        Jacobians of the prediction.
    """

    rows: IntArray
    columns: IntArray
    residuals: FloatArray
    covariances: FloatArray
    by_pose: FloatArray
    by_landmark: FloatArray

    def select(self, chosen: NDArray[np.bool_]) -> Innovation:
        """Return those that are chosen (R,)."""
        return Innovation(*(getattr(self, part.name)[chosen] for part in fields(self)))


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
    """

    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)
    existence: LandmarkExistence = field(default_factory=LandmarkExistence)

    def order(self, state: LandmarkParticles, observations: LandmarkObservations, belief: PoseBelief) -> IntArray:
        """Order (K,) of association: most certain first, by the best particle.

        So one of two landmarks side by side is not taken for the other if that is seen, too.
        """
        if self.association.uses_signatures or len(observations) < 2:
            return np.arange(len(observations))
        best = state.best
        known = state.exists[best]
        predicted, _, H_m = self.sensor.linearize(belief.poses[best], state.positions[best, known])
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
        Q = self.sensor.noise(observations)[k]
        predicted, H_x, H_m = self.sensor.linearize(belief.poses[rows], state.positions[rows, columns])
        L = transform_covariances(H_m, state.covariances[rows, columns]) + Q
        L += transform_covariances(H_x, belief.covariances[rows])
        residuals = self.sensor.residual(observations.values[k], predicted)
        return Innovation(rows, columns, residuals, L, H_x, H_m)

    def correct(self, state: LandmarkParticles, seen: Innovation) -> None:
        """Correct the observed landmarks, given the poses.

        Source: Probabilistic Robotics, Tables 13.1 and 13.2 (mean and covariance of the features).
        """
        places = seen.rows * state.positions.shape[1] + seen.columns
        means, covariances = state.positions.reshape(-1, 2), state.covariances.reshape(-1, 2, 2)
        kalman_update(means, covariances, places, seen.by_landmark, seen.covariances, seen.residuals)

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
        state.positions[of] = self.sensor.locate(belief.poses[rows], observations.values[k])
        _, _, H_m = self.sensor.linearize(belief.poses[rows], state.positions[of])
        state.covariances[of] = transform_covariances(inverse_2x2(H_m), self.sensor.noise(observations)[k])
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
        at = self.sensor.locate(belief.poses, observations.values[k])
        _, H_x, H_m = self.sensor.linearize(belief.poses, at)
        L = self.sensor.noise(observations)[k] + transform_covariances(H_x, belief.covariances)
        reach = np.trace(transform_covariances(inverse_2x2(H_m), L), axis1=1, axis2=2)
        reach = reach[:, None] + state.covariances[..., 0, 0] + state.covariances[..., 1, 1]
        x, y = (state.positions[..., i] - at[:, None, i] for i in (0, 1))
        away = x * x + y * y
        near: NDArray[np.bool_] = state.exists & (away <= distance * reach)
        crowded = np.flatnonzero(near.sum(axis=1) > _MOST_CANDIDATES)
        if len(crowded):
            nearness = np.where(near[crowded], away[crowded] / reach[crowded], math.inf)
            near[crowded] &= nearness <= np.partition(nearness, _MOST_CANDIDATES - 1, axis=1)[:, [_MOST_CANDIDATES - 1]]
        return near
