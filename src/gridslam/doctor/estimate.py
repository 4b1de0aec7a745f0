"""Values with their standard deviations, as a log determines them or not."""

from __future__ import annotations

import math
from typing import NamedTuple

from gridslam.doctor.robust_fit import Fit

__all__ = ["DETERMINED", "FEWEST", "LEAST_SPREAD", "VARIANCES", "ParameterEstimate", "estimate_parameter"]

_UNKNOWN = math.inf
FEWEST = 8  # intervals
VARIANCES = (1e-4, 2e-4)  # of odometry: heading per metre and per radian (rad^2), way per metre and per radian (m^2)
LEAST_SPREAD = 0.1  # of the residuals, in the standard deviations assumed
DETERMINED = {"scale": 0.01, "turn_scale": 0.015, "drift": 0.004, "yaw": 0.03, "skew": 0.015, "lever": 0.05}
"""Greatest standard deviations of what counts as determined: a third or less of what harms a map."""


class ParameterEstimate(NamedTuple):
    """A value, its standard deviation (infinite if the log does not determine it) and whether that is small enough."""

    value: float
    sigma: float = _UNKNOWN
    determined: bool = False

    def differs(self, from_value: float, by: float, sigmas: float = 4.0) -> bool:
        """Whether the value is determined, and differs by more than `by` and than `sigmas` deviations from another."""
        return self.determined and abs(self.value - from_value) > max(by, sigmas * self.sigma)


def estimate_parameter(fit: Fit, index: int, limit: float, floor: float = 0.0) -> ParameterEstimate:
    """One parameter of a fit, determined where its deviation is below the limit."""
    sigma = math.hypot(math.sqrt(max(fit.covariance[index, index], 0.0)), floor)
    return ParameterEstimate(float(fit.parameters[index]), sigma, sigma < limit)
