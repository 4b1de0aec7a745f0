"""Scans that a moving robot takes its time for: which twist sharpens them, and whether their beam times are true."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.slam.tracker_state import Found, Prediction, Seen, TrackerState
from gridslam.types import Beams, FloatArray

__all__ = ["Deskew"]

_ORDERS = (1, 0, -1)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Deskew:
    """Deskews a scan by the motion that its match tells.

    A scan goes on after its stamp, so its beams tell the twist to come: that of the motion up to the stamp, by the
    prediction or by the match, or that one grown by as much as since the scan before. The one by which most beams agree
    with the map is taken.

    Drivers exist that tell the times of beams in the wrong order, as their lidar turns the other way, or tell times
    that mean nothing. Deskewed by them a scan fits worse, so the order that fits best is found, and gone by.

    Parameters
    ----------
    turn_rad : float, rad
        A scan tells the order of its beams if the robot turns more than this while it is taken.
    doubt : float
        Share of the beams that must agree more, in the mean over the scans, in another order than the one told.
    scans : int
        So many scans count for the order told before the first is seen.
    """

    turn_rad: float = Field(default=0.02, gt=0)
    doubt: float = Field(default=0.005, ge=0)
    scans: int = Field(default=20, ge=1)

    def order(self, seen: Seen | None) -> int:
        """Order of the beams of a laser: 1 as told, 0 if none fits, -1 backward."""
        if seen is None:
            return 1
        count, none, backward = seen.orders.tolist()
        gains = (self.doubt, none / (count + self.scans), backward / (count + self.scans))
        return _ORDERS[gains.index(max(gains))]

    def __call__(
        self,
        state: TrackerState,
        predicted: Prediction,
        twist_to: Callable[[FloatArray], FloatArray],
        beams: Beams,
        find: Callable[[Beams], Found],
    ) -> tuple[Found, Beams]:
        """Find where a scan was taken, and how its beams are seen from there at its stamp; `state` learns the order.

        Parameters
        ----------
        state : TrackerState
            Before this scan.
        predicted : Prediction
            Where the scan should have been taken.
        twist_to : callable
            Velocity (3,) if the scan was taken from a pose (3,).
        beams : Beams
            As measured.
        find : callable
            Matches beams to the map.
        """
        order = self.order(state.sensors.get(beams.scan.sensor))
        sharp = beams.deskew(order * twist_to(predicted.pose))
        best = find(sharp)
        if not best.matched or not best.share:
            return best, sharp
        twist = twist_to(best.pose)
        for other in (twist, 2 * twist - state.twist):
            again = beams.deskew(order * other)
            found = find(again)
            if found.share > best.share:
                best, sharp = found, again
        self._learn(state, twist, beams, find)
        return best, sharp

    def _learn(self, state: TrackerState, twist: FloatArray, beams: Beams, find: Callable[[Beams], Found]) -> None:
        """Keep the number of scans that tell the order, and the sums of what the other orders gain in agreement."""
        seen, times = state.sensors[beams.scan.sensor], beams.scan.beam_times_s
        if times is not None and abs(twist[2] * (times[-1] - times[0])) > self.turn_rad:
            told, none, backward = (find(beams.deskew(order * twist)).share for order in _ORDERS)
            orders = seen.orders + np.array([1.0, none - told, backward - told])
            state.note(beams.scan.sensor, seen._replace(orders=orders))
