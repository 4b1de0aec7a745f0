"""Detect scans of two lasers, or of two robots, that come by one name: the view changes and is back again."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.doctor.views import OTHER, SAME, View
from gridslam.io.measurement import Measurement

_LOOKED_BACK = 4  # scans, among which is one of the same laser: two lasers seldom differ more in their rates
_FEWEST = 10  # scans that show what was seen before the scan before them
_OFTEN = 0.1  # of all scans: who passes closely, or a laser that fails for a moment, does so seldom


@final
@dataclass(slots=True)
class MixedScans:
    """The scans by the name of one laser, each compared with those just before: finds mixed_scans.

    Only where more than half of the ranges change by more than the turn scans are predicted, by the odometry where
    there is one.
    """

    scans: int = 0
    returned: int = 0
    _latest: deque[View] = field(default_factory=lambda: deque(maxlen=_LOOKED_BACK))

    def take(self, measurement: Measurement) -> None:
        """Take the next scan."""
        odometry, scan = measurement
        view = View(np.zeros(3) if odometry is None else odometry.pose, scan)
        self.scans += 1
        *earlier, last = self._latest or [view]
        if earlier and view.is_changed_from(last) and OTHER < _difference(view, last) < math.inf:
            self.returned += any(_difference(view, before) < SAME for before in earlier)
        self._latest.append(view)

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the finding on the laser of that name."""
        if self.returned < max(_FEWEST, _OFTEN * self.scans):
            return
        share = self.returned / self.scans
        yield Finding(
            "mixed_scans",
            Severity.ERROR,
            f"In {percent(share)} of the scans the view is another one than in the scan before, and the same as "
            "shortly before that: scans of two lasers, or of two robots, come by one name, or a mounting is missing.",
            share,
            "share",
            "Publish each laser on its own topic, with its own frame_id and a transform to the base.",
            sensor,
        )


def _difference(view: View, before: View) -> float:
    """How badly two scans agree; NaN or infinite where they have too little in common."""
    return math.nan if before.polar is None else view.differs_from(before.polar, before.pose)
