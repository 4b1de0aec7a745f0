"""Monte Carlo localization: a particle filter over the robot's pose in a known map.

bel(x_t) = eta p(z_t | x_t, m) integral p(x_t | u_t, x_t-1) bel(x_t-1) dx_t-1: particles move by the odometry, are
weighed by the scan, and survive by their weights. Augmented: where scans fit worse than they should, a share of the
belief is that the robot is somewhere else, and is drawn from the whole map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import between, compose, log
from gridslam.localization.belief import (
    CLUSTER_COVARIANCE,
    PoseEstimate,
    estimate_pose,
    join_hypotheses,
    propagate_covariance,
    sample_hypotheses,
    update_hypotheses,
)
from gridslam.localization.kld_sampling import KldSampling
from gridslam.localization.known_map import KnownMap, PoseLikelihood
from gridslam.localization.match_covariance import compute_match_covariance
from gridslam.localization.odometry_check import OdometryCheck
from gridslam.localization.place_verification import (
    CERTAINLY_INSIDE,
    MOST_SCANS,
    NO_SCANS,
    bound_outside_log_odds,
    compute_outside_log_odds,
    find_rivals,
    update_outside_log_odds,
)
from gridslam.localization.recovery import AugmentedRecovery, propose_poses
from gridslam.localization.state import LocalizationReport, LocalizationSkip, MonteCarloState
from gridslam.matching.beam_order import BeamOrder
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton, degenerate_direction
from gridslam.models.beam import BeamRangeFinder
from gridslam.models.endpoint import LikelihoodField
from gridslam.models.motion import DiffusionMotion, GMappingMotion, OdometryMotion
from gridslam.parameters import Kind, bounded, parameters
from gridslam.particles.initial import copy_poses, sample_gaussian
from gridslam.particles.policies import AlwaysResample, EffectiveSampleSizeBelow, MotionThreshold
from gridslam.particles.resampling import Systematic, normalize
from gridslam.scan import Thinning
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

_UNKNOWN_POSE = PoseEstimate(np.zeros(3), np.diag([1e6, 1e6, math.pi**2]), 0.0)
_ROUNDING = 1e-6 * np.eye(3)  # a millimetre, for beliefs without any spread
_MAX_EVALUATED = 500  # particles whose agreement with a scan stands for that of all


@final
@parameters(frozen=True)
class MonteCarloConfiguration:
    """Parts and parameters of the filter; each part is explained at its class.

    Parameters
    ----------
    odometry_check : OdometryCheck or None
        Whether the odometry is used, or the motion from scan to scan; None: always the odometry, as AMCL.
    motion : GMappingMotion, OdometryMotion or DiffusionMotion
        p(x_t | u_t, x_{t-1}), conditioned on the odometry since the last update. The default has noise across the
        motion, too: a base frame beside the wheels' axle slides sideways when the robot turns.
    sensor : LikelihoodField or BeamRangeFinder
        p(z_t | x_t, m), conditioned on the scan. Of 120 beams few count: they share the map's errors, by which places
        that look alike would be distinguished.
    recovery : AugmentedRecovery
        How probable it is that the robot is somewhere else.
    matcher : GaussNewton
        Moves the reported pose from the mean of the particles to where the scan fits best; max_iterations=0: not at
        all, as AMCL. Walls of a map that many scans have made, or someone has drawn, are lines: no end on them is but a
        dot. Of ends that all count, less information than 2 % along a direction is that of a corridor's cells.
    beam_order_margin : float, [0, 1]
        Gain of the inlier ratio required to deskew a scan in another order than its driver reports: some report beam
        times in reverse order or without meaning. Smaller gains occur by the rounding of the map to cells.
    kld : KldSampling
        How many particles survive.
    when_to_update : MotionThreshold
        Which scans update the particles: by what moved since the last one that did. 0.2 m and 0.2 rad.
    when_to_resample : EffectiveSampleSizeBelow or AlwaysResample
        When resampling is worth its loss of diversity.
    resample_interval : int, >= 1
        Resample at most every n-th update.
    max_beams : int, >= 1
        Maximum number of beams used per scan, evenly spaced.
    range_min_m, range_max_m : float, m
        Beams outside are not used: the first sees the robot itself, and beyond the second a lidar's beam is wider than
        what it hits.
    reach_m : float, m, > 0
        Distances from the map's obstacles saturate here: ten standard deviations of a beam.
    off_free_factor : float, (0, 1]
        What an update multiplies the weight of a particle with that is not on a free cell. Not 0: maps have specks, and
        a robot may drive where its map ends.
    lost_below : float, (0, 1]
        Inlier ratio with the map below which the robot is lost; random poses have 0.2. The lost probability starts to
        grow below one and a half times this ratio.
    lost_above : float, (0, 1)
        Lost probability above which the robot is lost. With two places that look alike it is far above, whatever little
        evidence a scan has.
    confirm_distance_m : float, m, > 0
        The lost probability of a new fix includes exp(-path / confirm_distance_m): driving on disambiguates places that
        look alike.

    Raises
    ------
    ConfigurationError
        A parameter is out of range, no beam could be used, or distances would saturate within a beam's noise.
    """

    odometry_check: Annotated[OdometryCheck | None, Kind()] = field(default_factory=OdometryCheck)
    motion: Annotated[GMappingMotion | OdometryMotion | DiffusionMotion, Kind()] = field(default_factory=GMappingMotion)
    sensor: Annotated[LikelihoodField | BeamRangeFinder, Kind()] = field(
        default_factory=lambda: LikelihoodField(tempering=0.05)
    )
    recovery: AugmentedRecovery = field(default_factory=AugmentedRecovery)
    matcher: GaussNewton = field(default_factory=lambda: GaussNewton(point_to_line=False, min_information=0.02))
    beam_order_margin: float = bounded(0.05, ge=0, le=1)
    kld: KldSampling = field(default_factory=KldSampling)
    when_to_update: MotionThreshold = field(default_factory=lambda: MotionThreshold(0.2, 0.2))
    when_to_resample: Annotated[EffectiveSampleSizeBelow | AlwaysResample, Kind()] = field(
        default_factory=EffectiveSampleSizeBelow
    )
    resample_interval: int = bounded(1, ge=1, le=1_000_000)
    max_beams: int = bounded(120, ge=1, le=100_000)
    range_min_m: float = bounded(0.05, ge=0, le=1e4)
    range_max_m: float = bounded(30.0, ge=1e-6, le=1e4)
    reach_m: float = bounded(1.0, ge=1e-6, le=1e6)
    off_free_factor: float = bounded(0.01, ge=1e-6, le=1)
    lost_below: float = bounded(0.3, ge=1e-6, le=1)
    lost_above: float = bounded(0.2, ge=1e-6, lt=1)
    confirm_distance_m: float = bounded(1.0, ge=1e-6, le=1e6)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if self.range_min_m >= self.range_max_m:
            raise ValueError("range_min_m must be less than range_max_m")
        if self.reach_m < self.sensor.sigma_hit_m:
            raise ValueError("reach_m must not be less than sensor.sigma_hit_m")


@final
@checked
@dataclass(frozen=True)
class MonteCarloLocalization:
    """The filter; it has no state of its own: `step` takes a state and returns the next one.

    Attributes
    ----------
    map : KnownMap
        Where the robot is.
    configuration : MonteCarloConfiguration
        What the filter is put together from.
    motion : MotionModel or None
        Instead of that of `configuration`.
    resampler : Resampler
        Which particles survive.

    References
    ----------
    Probabilistic Robotics, Tables 8.2 (`MCL`), 8.3 (`Augmented_MCL`) and 8.4 (`KLD_Sampling_MCL`).
    """

    map: KnownMap
    configuration: MonteCarloConfiguration = field(default_factory=MonteCarloConfiguration)
    motion: MotionModel | None = None
    resampler: Resampler = Systematic()

    def init(self, particles: FloatArray | None = None) -> MonteCarloState:
        """Begin with particles (N, 3) of equal weight (see `gridslam.particles.sample_gaussian`), or knowing nothing.

        Where nothing is known the first scan that is used draws the particles.
        """
        poses = np.empty((0, 3)) if particles is None else copy_poses(particles)
        log_weights = np.full(len(poses), -math.log(max(len(poses), 1)))
        known = len(poses) > 0
        return MonteCarloState(
            poses,
            log_weights,
            self.configuration.recovery.begin(),
            estimate_pose(poses, np.exp(log_weights)) if known else _UNKNOWN_POSE,
            driven_since_found_m=math.inf if known else 0.0,
            verified=known,
            outside_log_odds=CERTAINLY_INSIDE if known else None,
            looking=not known,
        )

    def init_gaussian(self, pose: ArrayLike, covariance: ArrayLike, rng: np.random.Generator) -> MonteCarloState:
        """Begin at a pose (3,) of which a covariance (3, 3) is known, with as many particles as there may be.

        The first scan is more informative than the initial pose, and few particles will be near that pose.
        Raises ArgumentError for anything that is no pose or covariance, and for a pose outside the map.
        """
        poses = sample_gaussian(self.configuration.kld.particles_max, pose, covariance, rng)
        self.map.require(pose)
        return self.init(poses)

    def step(
        self,
        state: MonteCarloState,
        odometry: Odometry | None,
        scan: LaserScan,
        rng: np.random.Generator,
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Take one scan; consumes `state` (keep one for later with `state.snapshot()`).

        The particles are updated if the robot has moved enough.
        Raises ArgumentError for an argument of another kind; `state` is kept then.
        """
        require_step(MonteCarloState, state, odometry, scan, rng)
        state = state.take()
        moved = self._moved(state, odometry, scan)
        beams = self._select_beams(state, odometry, moved, scan)
        if reason := self._skip_reason(state, odometry, moved, beams):
            report = self._report_skipped(state, odometry, scan, moved, reason)
            return state, self._refine_pose(state.note_found(report), beams)
        state.add_particles(*sample_hypotheses(state.hypotheses, len(state.poses), rng))
        poses = self._motion(moved)(state.poses, rng)  # x_t ~ p(x_t | u_t, x_t-1)
        log_likelihood = self._likelihood(beams)
        log_weights = state.log_weights + log_likelihood(poses)  # w_t = w_t-1 p(z_t | x_t, m)
        if share := self._injection_ratio(state, moved, poses, beams):  # max(0, 1 - w_fast / w_slow) of all
            poses, log_weights = self._inject_particles(poses, log_weights, share, beams, log_likelihood, rng)
        state.advance(poses, normalize(log_weights), odometry)
        weights = np.exp(state.log_weights)
        report = state.note_found(self._report_update(state, weights, scan, moved, beams, share, rng))
        report = self._refine_pose(report, beams)
        if self._should_resample(state, report):  # draw with probability w_t, as many as KLD-sampling asks for
            parents = self.configuration.kld(poses, weights, self.resampler, rng)
            state.resample(parents)
            report = replace(report, parents=parents, particles=len(parents))
        return state, report

    def _moved(self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan) -> FloatArray:
        """Return motion (3,) since the last update: by the odometry, unless the scans contradict it."""
        check = self.configuration.odometry_check
        if check is not None:
            beams = scan.beams(self.configuration.range_min_m, self.configuration.range_max_m, Thinning())
            state.tracked = check.track(state.tracked, odometry, beams)
        if odometry is None:
            return np.zeros(3)
        measured = between(state.odometry_at_update(odometry), odometry.pose)
        if check is None or state.tracked is None:
            return measured
        state.tracked, moved = check(state.tracked, measured, self._motion)
        return moved

    def _motion(self, moved: FloatArray) -> MotionSampler:
        return (self.motion or self.configuration.motion)(moved)

    def _select_beams(
        self, state: MonteCarloState, odometry: Odometry | None, moved: FloatArray, scan: LaserScan
    ) -> Beams:
        """Usable beams, evenly thinned, as they were at the scan's stamp."""
        beams = scan.beams(self.configuration.range_min_m, self.configuration.range_max_m)
        count = self.configuration.max_beams
        last = state.last
        if len(beams) > count:
            chosen = np.arange(count) * len(beams) // count
            beams = Beams(scan, beams.indices[chosen], beams.ends[chosen], beams.origin)
        if scan.beam_times_s is None or last is None or odometry is None or odometry.stamp_ns <= last.stamp_ns:
            return beams
        if state.odometry_rejected and state.tracked is not None:
            twist = np.array(state.tracked.tracker.twist)
        else:
            twist = log(between(last.pose, odometry.pose)) / (1e-9 * (odometry.stamp_ns - last.stamp_ns))
        if not len(state.poses) or not len(beams):
            return beams.deskew(twist)
        guess = compose(state.estimate.pose, moved)

        def share(beams: Beams) -> float:
            pose = self._match(guess, state.estimate.covariance, beams)
            return float(self.map.inlier_ratio(beams.ends)(pose[None])[0])

        order = BeamOrder().learn(beams, twist, share).best(self.configuration.beam_order_margin)
        return beams.deskew(order * twist)

    def _skip_reason(
        self, state: MonteCarloState, odometry: Odometry | None, moved: FloatArray, beams: Beams
    ) -> LocalizationSkip | None:
        if odometry is None:
            return LocalizationSkip.NO_ODOMETRY
        moved_enough = self.configuration.when_to_update(math.hypot(*moved[:2]), abs(float(moved[2])))
        if state.updates and not moved_enough:
            return LocalizationSkip.MOVED_TOO_LITTLE
        return None if len(beams) else LocalizationSkip.NO_VALID_BEAM

    def _refine_pose(self, report: LocalizationReport, beams: Beams) -> LocalizationReport:
        """Move the reported pose to the maximum of p(z_t | x_t, m) N(x_t; pose, covariance).

        The mean of the particles lags: their weights count few of the beams, and between updates only odometry moves
        them. The particles stay as they are, so this scan is not counted twice.
        """
        matcher = self.configuration.matcher
        if not report.particles or not matcher.max_iterations or len(beams) < matcher.min_beams:
            return report
        if report.lost:
            return replace(report, pose=self._match(report.pose, report.covariance, beams))
        pose = self._match_from_several(report.pose, report.covariance, beams)
        covariance = compute_match_covariance(self.map, matcher, pose, report.covariance + _ROUNDING, beams)
        return replace(report, pose=pose, covariance=covariance)

    def _match(self, pose: FloatArray, covariance: FloatArray, beams: Beams) -> FloatArray:
        return np.asarray(self._match_near(pose[None], covariance + _ROUNDING, beams)[0])

    def _match_near(self, guesses: FloatArray, covariance: FloatArray, beams: Beams) -> FloatArray:
        """Poses (K, 3) where a scan fits best, given that each has this covariance (3, 3) about its guess (K, 3)."""
        return self.map.match(self.configuration.matcher, guesses, self._prior(covariance), beams).poses

    def _prior(self, covariance: FloatArray) -> FloatArray:
        """Return information (3, 3) of a pose with this covariance (3, 3), beside residuals in m."""
        variance = self.map.blurred_sigma_m(self.configuration.sensor.sigma_hit_m) ** 2
        return np.asarray(variance * np.linalg.inv(covariance), np.float64)

    def _match_from_several(self, pose: FloatArray, covariance: FloatArray, beams: Beams) -> FloatArray:
        """Match from a pose (3,) of this covariance (3, 3), and from one standard deviation beside it.

        Where few beams determine a direction, as in a doorway, the likelihood has several maxima some centimetres
        apart, and that nearest to the mean may be another one than the greatest. Those that are found without the prior
        are compared with it afterwards, where they are determined by the scan.
        """
        matcher = self.configuration.matcher
        variances, axes = np.linalg.eigh(covariance[:2, :2])
        guesses = np.repeat(pose[None], 5, axis=0)
        guesses[1:, :2] += np.concatenate([axes.T, -axes.T]) * np.sqrt(np.tile(np.maximum(variances, 0), 2))[:, None]
        prior = self._prior(covariance + _ROUNDING)
        found = self.map.match(matcher, guesses, np.stack([prior, *[NO_PRIOR] * 4]), beams)
        others = zip(found.information[1:], found.score[1:].tolist(), strict=True)
        kept = [True, *(degenerate_direction(*other, matcher.min_information) is None for other in others)]
        poses = found.poses[kept]
        away = wrap_headings(poses - pose)
        agreement = matcher.cauchy_m**2 * found.score[kept]  # minus the sum of w d^2, to a constant
        cost = ((away @ prior) * away).sum(axis=1) - agreement
        return np.asarray(poses[cost.argmin()])

    def _likelihood(self, beams: Beams) -> PoseLikelihood:
        """Log likelihoods of poses (N, 3), which count less where there is no free space to be in."""
        log_likelihood = self.map.condition(self.configuration.sensor, beams)
        log_off_free = math.log(self.configuration.off_free_factor)
        return lambda poses: log_likelihood(poses) + np.where(self.map.is_free(poses), 0.0, log_off_free)

    def _injection_ratio(self, state: MonteCarloState, moved: FloatArray, poses: FloatArray, beams: Beams) -> float:
        """Probability that the robot is elsewhere, the weight of injected particles; 1 if the pose is unknown."""
        if not len(state.poses):
            return 1.0
        # Every n-th particle: who descends from one stands together.
        some = slice(None, None, max(1, len(state.poses) // _MAX_EVALUATED))
        weights = np.exp(state.log_weights[some] - state.log_weights[some].max())
        seen = self._see_mapped(state, compose(state.estimate.pose, moved), beams)
        ratios = self.map.inlier_ratio(beams.ends[seen])(poses[some]) if seen.any() else np.zeros(len(weights))
        state.averages, share = self.configuration.recovery(
            state.averages, float(weights @ ratios / weights.sum()), float(seen.mean())
        )
        return share

    def _see_mapped(self, state: MonteCarloState, pose: FloatArray, beams: Beams) -> NDArray[np.bool_]:
        """Return which beams (B,) are evidence for or against a place to which the robot has driven.

        A robot that was found and drives where nothing is mapped is not elsewhere: the map does not contradict it, as
        long as the belief is in one place. What ends there is no reason for a place that was not verified.
        """
        inside = state.outside_log_odds is None or state.outside_log_odds < 0
        if not (state.verified and inside and state.estimate.mass > 1 - self.configuration.lost_above):
            return np.ones(len(beams), np.bool_)
        return ~self.map.ends_beyond(pose, beams.ends, beams.origin)

    def _inject_particles(
        self,
        poses: FloatArray,
        log_weights: FloatArray,
        share: float,
        beams: Beams,
        log_likelihood: PoseLikelihood,
        rng: np.random.Generator,
    ) -> tuple[FloatArray, FloatArray]:
        """Mix particles into the belief that stand for a share of it, even over the map, and are weighed like it."""
        drawn, log_drawn = propose_poses(self.map, beams, log_likelihood, share, rng)
        if share == 1:
            return drawn, log_drawn
        mixed = np.concatenate([log_weights + math.log1p(-share), log_drawn + math.log(share)])
        return np.concatenate([poses, drawn]), mixed

    def _should_resample(self, state: MonteCarloState, report: LocalizationReport) -> bool:
        if state.updates % self.configuration.resample_interval:
            return False
        count = len(state.poses)
        return report.injection_ratio > 0 or self.configuration.when_to_resample(report.n_eff, count, count)

    def _report_update(
        self,
        state: MonteCarloState,
        weights: FloatArray,
        scan: LaserScan,
        moved: FloatArray,
        beams: Beams,
        share: float,
        rng: np.random.Generator,
    ) -> LocalizationReport:
        """Report of an update, before resampling; stores the estimate and the pose hypotheses in the state."""
        agree = self.map.inlier_ratio(beams.ends)
        estimate = estimate_pose(state.poses, weights)
        state.inlier_ratio = float(agree(estimate.pose[None])[0])
        state.update_estimate(estimate, moved)
        state.hypotheses = update_hypotheses(state.hypotheses, moved, estimate, state.poses, weights, agree, rng)
        self._verify_place(state, moved, beams, share, rng)
        return LocalizationReport(
            scan.stamp_ns,
            estimate.pose,
            *self._with_lost_probability(state, estimate.pose, estimate.covariance),
            state.inlier_ratio,
            len(state.poses),
            float(1 / np.square(weights).sum()),
            odometry_rejected=state.odometry_rejected,
            injection_ratio=share,
            poses=state.poses,
            log_weights=state.log_weights,
        )

    def _verify_place(
        self, state: MonteCarloState, moved: FloatArray, beams: Beams, share: float, rng: np.random.Generator
    ) -> None:
        """Search for other places before the reported one counts as found; they become hypotheses.

        Where the reported place is one of a `share` of particles drawn from all over the map, odometry may not connect
        this scan with those before.
        """
        before = NO_SCANS if share and not state.driven_since_found_m else state.recent
        state.recent = before.append(moved, beams, MOST_SCANS)
        reported = state.estimate.pose
        if state.outside_log_odds is None:
            state.outside_log_odds = compute_outside_log_odds(self.map, reported, state.recent, rng)
        else:
            state.outside_log_odds = update_outside_log_odds(state.outside_log_odds, self.map, reported, state.recent)
        if state.verified or self._lost_probability(state) > self.configuration.lost_above:
            return
        found, alike_m = find_rivals(
            self.map, reported, state.recent, lambda guesses: self._match_near(guesses, CLUSTER_COVARIANCE, beams), rng
        )
        state.outside_log_odds = bound_outside_log_odds(state.outside_log_odds, state.driven_since_found_m, alike_m)
        state.hypotheses = join_hypotheses(state.hypotheses, found, reported)
        state.verified = self._lost_probability(state) <= self.configuration.lost_above

    def _report_skipped(
        self,
        state: MonteCarloState,
        odometry: Odometry | None,
        scan: LaserScan,
        moved: FloatArray,
        reason: LocalizationSkip,
    ) -> LocalizationReport:
        """Report of a scan that did not update the particles: the pose of the last update, moved on by odometry."""
        state.last = odometry or state.last
        estimate = state.estimate
        pose = compose(estimate.pose, moved)
        noise = self._motion(moved).moments(estimate.pose[None])[1][0]
        covariance = propagate_covariance(estimate.covariance, pose[:2] - estimate.pose[:2], noise)
        return LocalizationReport(
            scan.stamp_ns,
            pose,
            *self._with_lost_probability(state, pose, covariance),
            state.inlier_ratio,
            len(state.poses),
            skipped=reason,
            odometry_rejected=state.odometry_rejected,
        )

    def _with_lost_probability(
        self, state: MonteCarloState, pose: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, float, bool]:
        """Return covariance, probability of being lost, and the lost flag.

        A lost robot may be at any of its pose hypotheses and, with the remaining probability, anywhere on the map.
        """
        probability = self._lost_probability(state)
        odds = state.hypotheses.odds
        if probability <= self.configuration.lost_above:
            return covariance, probability, False
        theirs = min(probability, odds / (1 + odds))
        elsewhere = theirs * state.hypotheses.spread_about(state.estimate.pose)
        elsewhere += (probability - theirs) * self.map.spread_about(pose)
        return (1 - probability) * covariance + elsewhere, probability, True

    def _lost_probability(self, state: MonteCarloState) -> float:
        """Combine the cluster's mass, the hypotheses elsewhere, the distance since the fix, and the fit of the scan.

        What recovery draws from elsewhere is in the belief already: it has been weighed by the scan.
        """
        outside = 0.0 if state.outside_log_odds is None else math.exp(state.outside_log_odds)
        place = min(state.estimate.mass, 1 / (1 + state.hypotheses.odds + outside))
        followed = -math.expm1(-state.driven_since_found_m / self.configuration.confirm_distance_m)
        fits = min(max(state.inlier_ratio / self.configuration.lost_below - 0.5, 0.0), 1.0) if state.updates else 1.0
        return 1 - place * followed * fits
