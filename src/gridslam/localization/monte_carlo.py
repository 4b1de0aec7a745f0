"""Monte Carlo localization: a particle filter over the robot's pose in a known map.

bel(x_t) = eta p(z_t | x_t, m) integral p(x_t | u_t, x_t-1) bel(x_t-1) dx_t-1: particles move by the odometry, are
weighed by the scan, and survive by their weights. Augmented: where scans fit worse than they should, a share of the
belief is that the robot is somewhere else, and is drawn from the whole map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.geometry.se2 import between, compose, log
from gridslam.localization.belief import Estimate, estimate, moved_covariance
from gridslam.localization.known_map import KnownMap, PoseWeigher
from gridslam.localization.parts import MonteCarloParts
from gridslam.localization.state import LocalizationReport, LocalizationSkip, MonteCarloState, checked_poses
from gridslam.models.endpoint import CauchyAgreement
from gridslam.particles.initial import spread
from gridslam.particles.resampling import Systematic
from gridslam.particles.weights import effective_sample_size, normalize
from gridslam.types import (
    Beams,
    FloatArray,
    LaserScan,
    MotionModel,
    MotionSampler,
    Odometry,
    Resampler,
    require_step,
)

__all__ = ["MonteCarloLocalization"]

_NOWHERE = Estimate(np.zeros(3), np.diag([1e6, 1e6, math.pi**2]), 0.0)
_AGREEMENT = CauchyAgreement(scale_m=0.1, tempering=1.0)
_ROUNDING = 1e-6 * np.eye(3)  # a millimetre, for beliefs without any spread
_ASKED = 500  # particles whose agreement with a scan stands for that of all


@final
@dataclass(frozen=True)
class MonteCarloLocalization:
    """The filter; what it knows is in the state that goes in and comes out of `step`.

    Attributes
    ----------
    map : KnownMap
        Where the robot is.
    parts : MonteCarloParts
        What the filter is put together from.
    motion : MotionModel or None
        Instead of that of `parts`.
    resampler : Resampler
        Which particles survive.

    Source: Probabilistic Robotics, Tables 8.2 (`MCL`), 8.3 (`Augmented_MCL`) and 8.4 (`KLD_Sampling_MCL`).
    """

    map: KnownMap
    parts: MonteCarloParts = field(default_factory=MonteCarloParts)
    motion: MotionModel | None = None
    resampler: Resampler = Systematic()

    def init(self, particles: FloatArray | None = None) -> MonteCarloState:
        """Begin with particles (N, 3) of equal weight (see `gridslam.particles.spread`), or knowing nothing.

        Where nothing is known the first scan that is used draws the particles.
        """
        poses = np.empty((0, 3)) if particles is None else checked_poses(particles)
        log_weights = np.full(len(poses), -math.log(max(len(poses), 1)))
        known = len(poses) > 0
        told = estimate(poses, np.exp(log_weights)) if known else _NOWHERE
        return MonteCarloState(poses, log_weights, self.parts.recovery.begin(), told, math.inf if known else 0.0)

    def around(self, pose: ArrayLike, covariance: ArrayLike, rng: np.random.Generator) -> MonteCarloState:
        """Begin at a pose (3,) of which a covariance (3, 3) is known, with as many particles as there may be.

        The first scan is more informative than the initial pose, and few particles will be near that pose.
        Raises ArgumentError for anything that is no pose or covariance, and for a pose outside the map.
        """
        poses = spread(self.parts.kld.particles_max, pose, covariance, rng)
        self.map.require(pose)
        return self.init(poses)

    def step(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Take one scan; consumes `state` (keep one for later with `state.snapshot()`).

        Raises ArgumentError for an argument of another kind; `state` is kept then.
        """
        require_step(MonteCarloState, state, odometry, scan, rng)
        state = state.take()
        moved = np.zeros(3) if odometry is None else between(state.odometry_or(odometry), odometry.pose)
        beams = self._beams(state, odometry, moved, scan)
        if reason := self._skip(state, odometry, moved, beams):
            return state, self._fitted(self._between_updates(state, odometry, scan, moved, reason), beams)
        poses = self._motion(moved)(state.poses, rng)  # predict
        weigh = self._weigher(beams)
        log_weights = state.log_weights + weigh(poses)  # weigh
        if share := self._elsewhere(state, poses, beams):  # augment
            poses, log_weights = self._augmented(poses, log_weights, share, beams, weigh, rng)
        state.advance(poses, normalize(log_weights), odometry)
        report = self._fitted(self._report(state, scan, moved, beams, share, rng), beams)
        if self._resamples(state, report):  # resample
            parents = self.parts.kld(poses, np.exp(state.log_weights), self.resampler, rng)
            state.resample(parents)
            report = replace(report, parents=parents, particles=len(parents))
        return state, report

    def _motion(self, moved: FloatArray) -> MotionSampler:
        return (self.motion or self.parts.motion)(moved)

    def _beams(self, state: MonteCarloState, odometry: Odometry | None, moved: FloatArray, scan: LaserScan) -> Beams:
        """Usable beams, evenly thinned, as they were at the scan's stamp."""
        beams, most, last = scan.beams(self.parts.range_min_m, self.parts.range_max_m), self.parts.max_beams, state.last
        if len(beams) > most:
            chosen = np.arange(most) * len(beams) // most
            beams = Beams(scan, beams.indices[chosen], beams.ends[chosen], beams.origin)
        if scan.beam_times_s is None or last is None or odometry is None or odometry.stamp_ns <= last.stamp_ns:
            return beams
        twist = log(between(last.pose, odometry.pose)) / (1e-9 * (odometry.stamp_ns - last.stamp_ns))
        if not len(state.poses):
            return beams.deskewed(twist)
        guess = compose(state.estimate.pose, moved)

        def share(beams: Beams) -> float:
            pose = self._matched(guess, state.estimate.covariance, beams)
            return float(self._agreement(beams)(pose[None])[0])

        return self.parts.deskew(beams, twist, share)

    def _skip(
        self, state: MonteCarloState, odometry: Odometry | None, moved: FloatArray, beams: Beams
    ) -> LocalizationSkip | None:
        if odometry is None:
            return LocalizationSkip.NO_ODOMETRY
        if state.updates and not self.parts.when_to_update(math.hypot(moved[0], moved[1]), abs(float(moved[2]))):
            return LocalizationSkip.MOVED_TOO_LITTLE
        return None if len(beams) else LocalizationSkip.NO_VALID_BEAM

    def _fitted(self, report: LocalizationReport, beams: Beams) -> LocalizationReport:
        """Move the reported pose to the maximum of p(z_t | x_t, m) N(x_t; pose, covariance).

        The mean of the particles lags: their weights count few of the beams, and between updates only odometry moves
        them. The particles stay as they are, so this scan is not counted twice.
        """
        if not report.particles:
            return report
        return replace(report, pose=self._matched(report.pose, report.covariance, beams))

    def _matched(self, pose: FloatArray, covariance: FloatArray, beams: Beams) -> FloatArray:
        variance = self.map.blurred_m(self.parts.sensor.sigma_hit_m) ** 2
        prior = np.asarray(variance * np.linalg.inv(covariance + _ROUNDING), np.float64)
        return self.map.match(self.parts.matcher, pose, prior, beams)

    def _weigher(self, beams: Beams) -> PoseWeigher:
        """Log likelihoods of poses (N, 3), which count less where there is no free space to be in."""
        weigh, log_off_free = self.map.weigher(self.parts.sensor, beams), math.log(self.parts.off_free)
        return lambda poses: weigh(poses) + np.where(self.map.is_free(poses), 0.0, log_off_free)

    def _elsewhere(self, state: MonteCarloState, poses: FloatArray, beams: Beams) -> float:
        """Probability that the robot is elsewhere, the weight of injected particles; 1 if the pose is unknown."""
        if not len(state.poses):
            return 1.0
        some = slice(None, None, max(1, len(state.poses) // _ASKED))  # who descends from one particle stands together
        weights = np.exp(state.log_weights[some] - state.log_weights[some].max())
        agreement = float(weights @ self._agreement(beams)(poses[some]) / weights.sum())
        state.averages, share = self.parts.recovery(state.averages, agreement)
        return share

    def _agreement(self, beams: Beams) -> PoseWeigher:
        """Share (N,) of the beams that agree with the map at poses (N, 3)."""
        agree = self.map.weigher(_AGREEMENT, beams)
        return lambda poses: agree(poses) / len(beams)

    def _augmented(
        self, poses: FloatArray, log_weights: FloatArray, share: float, beams: Beams, weigh: PoseWeigher,
        rng: np.random.Generator,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Mix particles into the belief that stand for a share of it, even over the map, and are weighed like it."""
        drawn, log_drawn = self.parts.proposal(self.map, beams, weigh, share, rng)
        if share == 1:
            return drawn, log_drawn
        mixed = np.concatenate([log_weights + math.log1p(-share), log_drawn + math.log(share)])
        return np.concatenate([poses, drawn]), mixed

    def _resamples(self, state: MonteCarloState, report: LocalizationReport) -> bool:
        if state.updates % self.parts.resample_interval:
            return False
        return report.augmented > 0 or self.parts.when_to_resample(report.n_eff, len(state.poses))

    def _report(
        self, state: MonteCarloState, scan: LaserScan, moved: FloatArray, beams: Beams, share: float,
        rng: np.random.Generator,
    ) -> LocalizationReport:  # fmt: skip
        """Report of an update, before resampling; stores the estimate and the pose hypotheses in the state."""
        weights, agree = np.exp(state.log_weights), self._agreement(beams)
        told = estimate(state.poses, weights)
        state.agreement = float(agree(told.pose[None])[0])
        state.follow(told, moved)
        state.rivals = self.parts.rivals(state.rivals, moved, told, state.poses, weights, agree, rng)
        return LocalizationReport(
            scan.stamp_ns, told.pose, *self._doubted(state, told.pose, told.covariance), state.agreement,
            len(state.poses), effective_sample_size(state.log_weights), augmented=share, poses=state.poses,
            log_weights=state.log_weights,
        )  # fmt: skip

    def _between_updates(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, moved: FloatArray,
        reason: LocalizationSkip,
    ) -> LocalizationReport:  # fmt: skip
        """Report of a scan that did not update the particles: the pose of the last update, moved on by odometry."""
        state.last, told = odometry or state.last, state.estimate
        pose = compose(told.pose, moved)
        noise = self._motion(moved).moments(told.pose[None])[1][0]
        covariance = moved_covariance(told.covariance, pose[:2] - told.pose[:2], noise)
        return LocalizationReport(
            scan.stamp_ns, pose, *self._doubted(state, pose, covariance), state.agreement, len(state.poses),
            skipped=reason,
        )  # fmt: skip

    def _doubted(
        self, state: MonteCarloState, pose: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, float, bool]:
        """Covariance, probability of being lost, and the lost flag.

        A lost robot may be at any of its pose hypotheses and, with the remaining probability, anywhere on the map.
        """
        probability, rivals = self._lost_probability(state), state.rivals
        if probability <= self.parts.lost_above:
            return covariance, probability, False
        theirs = min(probability, rivals.odds / (1 + rivals.odds))
        elsewhere = theirs * rivals.spread_about(state.estimate.pose)
        elsewhere += (probability - theirs) * self.map.spread_about(pose)
        return (1 - probability) * covariance + elsewhere, probability, True

    def _lost_probability(self, state: MonteCarloState) -> float:
        """Combine the cluster's mass, the other hypotheses, the distance since the fix, and the fit of the scan.

        What recovery draws from elsewhere is in the belief already: it has been weighed by the scan.
        """
        place = min(state.estimate.mass, 1 / (1 + state.rivals.odds))
        followed = -math.expm1(-state.followed_m / self.parts.follow_m)
        fits = min(max(state.agreement / self.parts.lost_below - 0.5, 0.0), 1.0) if state.updates else 1.0
        return 1 - place * followed * fits
