"""Deskewing of scans, and detection of wrong beam times."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.slam.tracking.state import PoseEstimate, Prediction, SensorTrack, TrackerState
from gridslam.types import Beams, FloatArray

__all__ = ["TrackerDeskew"]

_ORDERS = (1, 0, -1)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class TrackerDeskew:
    """Deskews a scan by the motion that its match yields.

    A scan goes on after its stamp, so its beams depend on the following twist: that of the motion up to the stamp, by
    the prediction or by the match, or that one grown by as much as since the scan before. The one by which most beams
    agree with the map is taken.

    Some drivers report beam times in reverse order or without meaning. The order with the highest inlier ratio is used.

    Parameters
    ----------
    turn_rad : float, rad
        A scan contributes to the estimate of the beam order if the robot turns by more than this during the scan.
    order_margin : float
        Gain of the inlier ratio, averaged over the scans, required to use an order other than the reported one.
    prior_scans : int
        Prior weight of the reported order, in scans.
    """

    turn_rad: float = Field(default=0.02, gt=0)
    order_margin: float = Field(default=0.005, ge=0)
    prior_scans: int = Field(default=20, ge=1)

    def find_order(self, track: SensorTrack | None) -> int:
        """Order of the beams of a laser: 1 as reported, 0 if none fits, -1 reversed."""
        if track is None:
            return 1
        count, none, backward = track.beam_order_sums.tolist()
        gains = (self.order_margin, none / (count + self.prior_scans), backward / (count + self.prior_scans))
        return _ORDERS[gains.index(max(gains))]

    def __call__(
        self,
        state: TrackerState,
        predicted: Prediction,
        twist_to: Callable[[FloatArray], FloatArray],
        beams: Beams,
        find: Callable[[Beams], PoseEstimate],
    ) -> tuple[PoseEstimate, Beams]:
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
        order = self.find_order(state.sensors.get(beams.scan.sensor))
        sharp = beams.deskew(order * twist_to(predicted.pose))
        best = find(sharp)
        if not best.matched or not best.inlier_ratio:
            return best, sharp
        twist = twist_to(best.pose)
        for other in (twist, 2 * twist - state.twist):
            again = beams.deskew(order * other)
            found = find(again)
            if found.inlier_ratio > best.inlier_ratio:
                best, sharp = found, again
        self._learn(state, twist, beams, find)
        return best, sharp

    def _learn(
        self, state: TrackerState, twist: FloatArray, beams: Beams, find: Callable[[Beams], PoseEstimate]
    ) -> None:
        """Update the number of scans used for the beam order, and the gains in agreement of the other orders."""
        track, times = state.sensors[beams.scan.sensor], beams.scan.beam_times_s
        if times is not None and abs(twist[2] * (times[-1] - times[0])) > self.turn_rad:
            told, none, backward = (find(beams.deskew(order * twist)).inlier_ratio for order in _ORDERS)
            orders = track.beam_order_sums + np.array([1.0, none - told, backward - told])
            state.update_track(beams.scan.sensor, track._replace(beam_order_sums=orders))
