"""The order in which a laser measures its beams, found from the order in which scans fit a map best."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np

from gridslam.types import Beams, FloatArray

ORDERS = (1, 0, -1)
"""Beams are measured as reported, all at once, or in the reverse order: factors of their times."""

MIN_TURN_RAD = 0.02
"""Turn of the robot during a scan from which on its order can be seen: ends 5 m away are moved by two cells."""


@final
class BeamOrder(NamedTuple):
    """Inlier ratios of scans of a turning robot, deskewed in each of `ORDERS`; more of them make a new one.

    Some drivers report beam times in reverse order or without meaning, and many report none.
    """

    scans: float = 0.0
    at_once: float = 0.0  # sum over scans of what the inlier ratio gains if the beams were measured at once
    backward: float = 0.0  # ... and in the reverse order

    def add(self, in_order: float, at_once: float, backward: float) -> BeamOrder:
        """Add the inlier ratios of one scan."""
        return BeamOrder(self.scans + 1, self.at_once + (at_once - in_order), self.backward + (backward - in_order))

    def learn(self, beams: Beams, twist: FloatArray, inlier_ratio: Callable[[Beams], float]) -> BeamOrder:
        """Add a scan taken at the velocity `twist` (3,); unchanged if it has no beam times or the robot hardly turned.

        `inlier_ratio` matches beams to the map.
        """
        times = beams.scan.beam_times_s
        if times is None or not len(times) or abs(twist[2]) * np.ptp(times) <= MIN_TURN_RAD:
            return self
        return self.add(*(inlier_ratio(beams.deskew(order * twist)) for order in ORDERS))

    def best(self, margin: float, prior_scans: float = 0) -> int:
        """The order of greatest inlier ratio, one of `ORDERS`.

        Parameters
        ----------
        margin : float, >= 0
            Gain of the mean inlier ratio required to use an order other than the reported one.
        prior_scans : float, >= 0
            Number of scans for which the reported order counts beforehand.
        """
        scans = max(self.scans + prior_scans, 1.0)
        gains = (margin, self.at_once / scans, self.backward / scans)
        return ORDERS[gains.index(max(gains))]
