"""Deskewing for localization, and detection of wrong beam times."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.models.parameters import STRICT
from gridslam.types import Beams, FloatArray

__all__ = ["LocalizationDeskew"]


@final
@parameters(frozen=True, config=STRICT)
class LocalizationDeskew:
    """Deskews a scan by the times of its beams, in the order by which it fits the map.

    Some drivers report these times in reverse order or without meaning. A known map detects this, scan by scan.

    Parameters
    ----------
    turn_rad : float, rad, >= 0
        A scan contributes to the estimate of the beam order if the robot turns by more than this during the scan.
    margin : float, [0, 1]
        Gain of the inlier ratio required to use an order other than the reported one; smaller gains occur by the
        rounding of the map to cells.
    """

    turn_rad: float = Field(default=0.02, ge=0)
    margin: float = Field(default=0.05, ge=0, le=1)

    def __call__(self, beams: Beams, twist: FloatArray, share: Callable[[Beams], float]) -> Beams:
        """Beams as they were at the scan's stamp.

        Parameters
        ----------
        beams : Beams
            As measured, of a scan with beam times.
        twist : (3,) float64, m/s, m/s, rad/s
            Velocity of the base.
        share : callable
            Inlier ratio after matching to the map.
        """
        told, times = beams.deskew(twist), beams.scan.beam_times_s
        if times is None or abs(twist[2]) * (times.max() - times.min()) <= self.turn_rad:
            return told
        orders = told, beams, beams.deskew(-twist)
        shares = [share(order) for order in orders]
        best = shares.index(max(shares))
        return orders[best] if shares[best] > shares[0] + self.margin else told
