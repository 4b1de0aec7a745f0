"""Scans that a moving robot takes its time for, straightened: and whether the times of their beams are true."""

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

    Drivers exist that tell these times in the wrong order, as their lidar turns the other way, or tell times that mean
    nothing. A known map refutes them, scan by scan.

    Parameters
    ----------
    turn_rad : float, rad, >= 0
        A scan tells the order of its beams if the robot turns more than this while it is taken.
    margin : float, [0, 1]
        Share of the beams that must agree more in another order than in the one that is told; by less, shares differ
        where a map is rounded to cells.
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
            Share of the beams that agree with the map, once they are matched to it.
        """
        told, times = beams.deskew(twist), beams.scan.beam_times_s
        if times is None or abs(twist[2]) * (times.max() - times.min()) <= self.turn_rad:
            return told
        orders = told, beams, beams.deskew(-twist)
        shares = [share(order) for order in orders]
        best = shares.index(max(shares))
        return orders[best] if shares[best] > shares[0] + self.margin else told
