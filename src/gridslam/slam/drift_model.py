"""How uncertain tracked motion is."""

from __future__ import annotations

from typing import final

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

__all__ = ["DriftModel"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class DriftModel:
    """How uncertain a tracked increment is: a random walk, and a leap wherever the tracker did not believe its match.

    Parameters
    ----------
    still_m, still_rad : float
        Standard deviation of an increment without motion.
    m, rad : float
        Standard deviation of the position after a metre, of the heading after a radian.
    m_of_turn, rad_of_way : float
        Standard deviation of the position after a radian, of the heading after a metre.
    doubt : float
        Where the tracker did not believe its match it took the odometry; there so many of the odometry's standard
        deviations are added: the wheels may have slipped, or a reading have come late.
    """

    still_m: float = Field(default=0.002, gt=0)
    still_rad: float = Field(default=0.0005, gt=0)
    m: float = Field(default=0.025, ge=0)
    rad: float = Field(default=0.004, ge=0)
    m_of_turn: float = Field(default=0.02, ge=0)
    rad_of_way: float = Field(default=0.002, ge=0)

    doubt: float = Field(default=1.5, ge=0)

    def variances(self, moved_m: float, turned_rad: float) -> tuple[float, float]:
        """Variances (m^2, rad^2) of an increment of so many metres and radians."""
        return (
            self.still_m**2 + self.m**2 * moved_m + self.m_of_turn**2 * turned_rad,
            self.still_rad**2 + self.rad**2 * turned_rad + self.rad_of_way**2 * moved_m,
        )
