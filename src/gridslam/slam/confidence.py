"""What the filter says about how much it knows: covariances, undetermined directions, the lost flag."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.matching.gauss_newton import degenerate_direction
from gridslam.particles.weights import effective_sample_size
from gridslam.slam.proposals import Proposed
from gridslam.slam.state import GridFastSlamState
from gridslam.types import BeamEnds, FloatArray, LaserScan, SkipReason, StepReport

__all__ = ["Confidence"]


_MIN_INFORMATION = 1e-2 * np.eye(3)
"""Information (1/m^2, 1/rad^2) assumed at least: nothing is less certain than 10 m and 10 rad."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Confidence:
    """Builds the reports of the filter.

    The covariance of a pose is the spread of the particles about the best one plus what its match leaves open; between
    key scans a random walk is added.

    Parameters
    ----------
    sigma_m : float, m
        Standard deviation of what one beam says about the pose, beams being correlated.
    lost_below : float
        Share of the beams that must agree with the best map; below it the pose is not to be trusted. Entering a room
        for the first time leaves about a third.
    drift_m, drift_rad : float
        Standard deviation of the tracker's error after one metre or radian.
    """

    sigma_m: float = Field(default=0.05, gt=0)
    lost_below: float = Field(default=0.15, ge=0, le=1)
    drift_m: float = Field(default=0.02, ge=0)
    drift_rad: float = Field(default=0.01, ge=0)

    def first_scan(self, state: GridFastSlamState, scan: LaserScan) -> StepReport:
        """Report of the scan that the filter begins with: a key scan that weighs nothing."""
        state.covariance = self._spread(state)
        n_eff = effective_sample_size(state.log_weights)
        return StepReport(
            scan.stamp_ns, state.poses[state.best], state.covariance, np.zeros(3), best=state.best, n_eff=n_eff,
            poses=state.poses, log_weights=state.log_weights,
        )  # fmt: skip

    def between_key_scans(
        self, state: GridFastSlamState, scan: LaserScan, key_from_base: FloatArray, reason: SkipReason
    ) -> StepReport:
        """Report of a scan that did not step the particles: the best one's key pose, moved on by the tracker."""
        dx, dy, turn = key_from_base.tolist()
        covariance, best, moved = state.covariance.copy(), state.best, math.hypot(dx, dy) + abs(turn)
        covariance[0, 0] += moved * self.drift_m**2
        covariance[1, 1] += moved * self.drift_m**2
        covariance[2, 2] += moved * self.drift_rad**2
        return StepReport(
            scan.stamp_ns, compose(state.poses[best], key_from_base), covariance, key_from_base, lost=state.lost,
            skipped=reason, best=best,
        )  # fmt: skip

    def key_scan(
        self, state: GridFastSlamState, scan: LaserScan, key_from_base: FloatArray, proposed: Proposed, beams: BeamEnds
    ) -> StepReport:
        """Report of a key scan, before resampling; keeps the covariance and the lost flag in the state."""
        best, match = state.best, proposed.match
        information, score = match.information[best], float(match.score[best])
        state.covariance = self._spread(state) + np.linalg.inv(information / self.sigma_m**2 + _MIN_INFORMATION)
        # the second key scan is not judged: a first scan that saw nothing leaves an empty map
        state.lost = score < self.lost_below * len(beams) and state.ancestry.steps > 2
        return StepReport(
            scan.stamp_ns, state.poses[best], state.covariance, key_from_base,
            undetermined=degenerate_direction(information, score), lost=state.lost, best=best,
            n_eff=effective_sample_size(state.log_weights), poses=state.poses, log_weights=state.log_weights,
        )  # fmt: skip

    @staticmethod
    def _spread(state: GridFastSlamState) -> FloatArray:
        """Weighted covariance (3, 3) of the particles about the best one."""
        away = state.poses - state.poses[state.best]
        away[:, 2] = wrap(away[:, 2])
        spread: FloatArray = (np.exp(state.log_weights) * away.T) @ away
        return spread
