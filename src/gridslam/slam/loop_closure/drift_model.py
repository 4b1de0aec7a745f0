"""How uncertain tracked motion is."""

from __future__ import annotations

from typing import final

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

__all__ = ["DriftModel"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class DriftModel:
    """Uncertainty of a tracked increment: a random walk, plus extra variance where the tracker rejected its scan match.

    Parameters
    ----------
    standstill_sigma_m, standstill_sigma_rad : float
        Standard deviation of an increment without motion.
    sigma_m_per_sqrt_m, sigma_rad_per_sqrt_rad : float
        Standard deviation of the position after a metre, of the heading after a radian.
    sigma_m_per_sqrt_rad, sigma_rad_per_sqrt_m : float
        Standard deviation of the position after a radian, of the heading after a metre.
    rejected_match_sigmas : float
        Multiple of the odometry's standard deviations that is added where the tracker rejected its match and used the
        odometry, which may suffer from slip or latency.
    """

    standstill_sigma_m: float = Field(default=0.002, gt=0)
    standstill_sigma_rad: float = Field(default=0.0005, gt=0)
    sigma_m_per_sqrt_m: float = Field(default=0.025, ge=0)
    sigma_rad_per_sqrt_rad: float = Field(default=0.004, ge=0)
    sigma_m_per_sqrt_rad: float = Field(default=0.02, ge=0)
    sigma_rad_per_sqrt_m: float = Field(default=0.002, ge=0)

    rejected_match_sigmas: float = Field(default=1.5, ge=0)

    def variances(self, moved_m: float, turned_rad: float) -> tuple[float, float]:
        """Variances (m^2, rad^2) of an increment."""
        return (
            self.standstill_sigma_m**2
            + self.sigma_m_per_sqrt_m**2 * moved_m
            + self.sigma_m_per_sqrt_rad**2 * turned_rad,
            self.standstill_sigma_rad**2
            + self.sigma_rad_per_sqrt_rad**2 * turned_rad
            + self.sigma_rad_per_sqrt_m**2 * moved_m,
        )
