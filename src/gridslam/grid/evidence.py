"""Evidence of a beam for a cell, in fixed-point log-odds."""

from __future__ import annotations

from typing import final

from gridslam.errors import ArgumentError
from gridslam.kernels import UNKNOWN

__all__ = ["LOG_ODDS_UNIT", "Evidence"]

LOG_ODDS_UNIT = 0.01
"""Nats in one step of a stored log-odds."""


@final
class Evidence:
    """What a beam adds to a cell's log-odds, and the clamps, rounded to steps of `LOG_ODDS_UNIT`.

    Parameters
    ----------
    hit, miss, minimum, maximum, occupied_above : float, nats
        `occupied_above` is the log-odds above which a cell counts as occupied for the distance field.
    """

    __slots__ = ("occupied_above", "steps")

    def __init__(self, hit: float, miss: float, minimum: float, maximum: float, occupied_above: float) -> None:
        steps = tuple(round(v / LOG_ODDS_UNIT) for v in (hit, miss, minimum, maximum, occupied_above))
        if not (steps[1] < 0 < steps[0] and UNKNOWN < steps[2] < 0 < steps[3] and steps[3] - steps[2] < -UNKNOWN):
            got = hit, miss, minimum, maximum
            raise ArgumentError("Evidence", "miss < 0 < hit and clamps less than 327 nats apart", got)
        self.steps: tuple[int, ...] = steps
        self.occupied_above: int = steps[4]
