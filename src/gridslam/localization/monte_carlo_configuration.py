"""Configuration of Monte Carlo localization."""

from __future__ import annotations

from typing import Annotated, final

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass as parameters

from gridslam.localization.kld_sampling import KldSampling
from gridslam.localization.pose_hypotheses import HypothesisTracker
from gridslam.localization.recovery import AugmentedRecovery, MeasurementProposal
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.models.beam import BeamRangeFinder
from gridslam.models.likelihood_field import LikelihoodField
from gridslam.models.motion import DiffusionMotion, GMappingMotion, OdometryMotion
from gridslam.models.parameters import STRICT, Kind
from gridslam.particles.policies import AlwaysResample, EffectiveSampleSizeBelow, MotionThreshold

__all__ = ["MonteCarloConfiguration"]


def _sensor() -> LikelihoodField:
    """Of 120 beams few count: they share the map's errors, by which places that look alike would be distinguished."""
    return LikelihoodField(tempering=0.05)


def _matcher() -> GaussNewton:
    """Walls of a map that many scans have made, or someone has drawn, are lines: no end on them is but a dot."""
    return GaussNewton(dense_spacing_m=0.0)


def _when_to_update() -> MotionThreshold:
    return MotionThreshold(0.2, 0.2)


@final
@parameters(frozen=True, config=STRICT)
class MonteCarloConfiguration:
    """Parts and parameters of the filter; each part is explained at its class.

    Parameters
    ----------
    motion : GMappingMotion, OdometryMotion or DiffusionMotion
        p(x_t | u_t, x_{t-1}), conditioned on the odometry since the last update. The default has noise across the
        motion, too: a base frame beside the wheels' axle slides sideways when the robot turns.
    sensor : LikelihoodField or BeamRangeFinder
        p(z_t | x_t, m), conditioned on the scan.
    recovery : AugmentedRecovery
        How probable it is that the robot is somewhere else.
    proposal : MeasurementProposal
        Where it may be, then and at the start.
    hypotheses : HypothesisTracker
        Tracking of alternative pose hypotheses.
    matcher : GaussNewton
        Moves the reported pose from the mean of the particles to where the scan fits best; max_iterations=0: not at
        all, as AMCL.
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
    pydantic.ValidationError
        A parameter is out of range, no beam could be used, or distances would saturate within a beam's noise.
    """

    motion: Annotated[GMappingMotion | OdometryMotion | DiffusionMotion, Kind()] = Field(default_factory=GMappingMotion)
    sensor: Annotated[LikelihoodField | BeamRangeFinder, Kind()] = Field(default_factory=_sensor)
    recovery: AugmentedRecovery = Field(default_factory=AugmentedRecovery)
    proposal: MeasurementProposal = Field(default_factory=MeasurementProposal)
    hypotheses: HypothesisTracker = Field(default_factory=HypothesisTracker)
    matcher: GaussNewton = Field(default_factory=_matcher)
    beam_order_margin: float = Field(default=0.05, ge=0, le=1)
    kld: KldSampling = Field(default_factory=KldSampling)
    when_to_update: MotionThreshold = Field(default_factory=_when_to_update)
    when_to_resample: Annotated[EffectiveSampleSizeBelow | AlwaysResample, Kind()] = Field(
        default_factory=EffectiveSampleSizeBelow
    )
    resample_interval: int = Field(default=1, ge=1)
    max_beams: int = Field(default=120, ge=1)
    range_min_m: float = Field(default=0.05, ge=0)
    range_max_m: float = Field(default=30.0, gt=0)
    reach_m: float = Field(default=1.0, gt=0)
    off_free_factor: float = Field(default=0.01, gt=0, le=1)
    lost_below: float = Field(default=0.3, gt=0, le=1)
    lost_above: float = Field(default=0.2, gt=0, lt=1)
    confirm_distance_m: float = Field(default=1.0, gt=0)

    @model_validator(mode="after")
    def _check_ranges(self) -> MonteCarloConfiguration:
        if self.range_min_m >= self.range_max_m:
            raise ValueError("range_min_m must be less than range_max_m")
        if self.reach_m < self.sensor.sigma_hit_m:
            raise ValueError("reach_m must not be less than sensor.sigma_hit_m")
        return self
