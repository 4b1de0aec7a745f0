"""Whether a landmark is there: evidence from being seen, and from not being seen where it should have been."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray

__all__ = ["LandmarkExistence"]


@final
@parameters(frozen=True, config=STRICT)
class LandmarkExistence:
    """Log odds that a landmark exists, by a binary Bayes filter.

    A landmark begins with the evidence of having been seen once. It is provisional until its log odds reach
    `log_odds_confirmed`, and dropped where they fall below 0. They saturate, so that what a wrong correspondence made
    can fade. In EKF SLAM it is provisional again when they fall below `log_odds_confirmed`; in FastSLAM it stays
    confirmed until it is dropped, for what is hidden for a while is still there, and a wrong one ends with the particle
    that made it.

    Parameters
    ----------
    detection : float, (0, 1)
        Probability that a landmark in view is seen; MRCLAM's cameras see a third of the barcodes in view.
    false_alarm : float, (0, detection)
        Probability that, where there is none, something is seen and taken for it.
    log_odds_confirmed : float, nats, > 0
        Log-odds after three observations, with the defaults.
    log_odds_max : float, nats, >= log_odds_confirmed
        Where the log odds saturate: so far above `log_odds_confirmed` that what is hidden for some seconds stays.
    range_min_m, range_max_m : float, m
        Between which distances landmarks are in view; well within what the sensor reaches.
    half_angle_rad : float, rad, (0, pi]
        Up to which bearing, to both sides.

    Source: Montemerlo et al., FastSLAM 2.0 (IJCAI 2003), section 4; Probabilistic Robotics, 13.6 and Table 13.2.
    """

    detection: float = Field(default=0.3, gt=0, lt=1)
    false_alarm: float = Field(default=0.03, gt=0, lt=1)
    log_odds_confirmed: float = Field(default=6.0, gt=0)
    log_odds_max: float = Field(default=12.0, gt=0)
    range_min_m: float = Field(default=1.0, ge=0)
    range_max_m: float = Field(default=5.0, gt=0)
    half_angle_rad: float = Field(default=0.4, gt=0, le=math.pi)

    @model_validator(mode="after")
    def _ordered(self) -> LandmarkExistence:
        if not (self.false_alarm < self.detection and self.log_odds_confirmed <= self.log_odds_max):
            raise ValueError("expected false_alarm < detection and log_odds_confirmed <= log_odds_max")
        return self

    @property
    def log_odds_detected(self) -> float:
        """Evidence of an observation, nats."""
        return math.log(self.detection / self.false_alarm)

    @property
    def log_odds_missed(self) -> float:
        """What not being seen in view adds, nats; below 0."""
        return math.log((1 - self.detection) / (1 - self.false_alarm))

    def __call__(
        self, evidence: FloatArray, seen: NDArray[np.bool_], poses: FloatArray, landmarks: FloatArray
    ) -> FloatArray:
        """Update the log odds (...) of landmarks (..., 2) that were seen (...) or not from poses (..., 3)."""
        x, y = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        square = x * x + y * y
        near = (square > self.range_min_m**2) & (square < self.range_max_m**2)
        bearing = wrap(np.arctan2(y, x) - poses[..., 2])
        missed = ~seen & near & (np.abs(bearing) < self.half_angle_rad)
        added = evidence + self.log_odds_detected * seen + self.log_odds_missed * missed
        updated: FloatArray = np.minimum(added, self.log_odds_max)
        return updated
