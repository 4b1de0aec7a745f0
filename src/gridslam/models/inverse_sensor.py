"""Inverse measurement model of one cell: evidence for its occupancy from the end or the passage of a beam."""

from __future__ import annotations

import math
from typing import final

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.parameters import bounded, parameters


def _four_probabilities(hit: float, miss: float) -> tuple[float, float, float, float]:
    """Solve a/c = e^hit and b/d = e^miss with a + b = c + d = 1 for (a, b, c, d)."""
    spread = math.exp(hit) - math.exp(miss)
    false_occupied = -math.expm1(miss) / spread
    true_free = math.expm1(hit) / spread
    return false_occupied * math.exp(hit), true_free * math.exp(miss), false_occupied, true_free


# Evidence beyond this needs probabilities that double precision cannot distinguish from 1.
_CERTAIN = 20.0
_LEAST = 0.01  # nats: one step of a map's log-odds

# Evidence of +2.4 and -0.4 nats, six to one: a beam that ends in a cell has far more evidence than one that grazes it.
_DEFAULT = _four_probabilities(2.4, -0.4)


@final
@checked
@parameters(frozen=True)
class InverseSensorModel:
    """The four probabilities of a binary sensor, and the log-odds by which a cell's belief moves.

    The measurement z of a cell is `occupied` where a beam ends in it and `free` where a beam passes through it. By
    Bayes' rule each measurement adds log p(z | occupied) - log p(z | free) to the cell's log-odds, up to the clamps.

    Parameters
    ----------
    true_occupied : float, (0, 1)
        p(z = occupied | cell occupied). The default is small: beams that graze an occupied cell pass it, too.
    false_free : float, (0, 1)
        p(z = free | cell occupied), which is 1 - true_occupied.
    false_occupied : float, (0, 1)
        p(z = occupied | cell free), below true_occupied.
    true_free : float, (0, 1)
        p(z = free | cell free), which is 1 - false_occupied.
    log_odds_min, log_odds_max : float, nats
        Where the belief is clamped, so that a changed world can be unlearned: forty passages, or fourteen ends.
    log_odds_occupied : float, nats
        A cell above this is an obstacle for matching: 2.0 is below one hit, so a wall serves once it is seen.

    Raises
    ------
    ConfigurationError
        A pair does not sum to 1, an end or a passage is no evidence of 0.01 to 20 nats, or the clamps, of at most 150
        nats, are out of order.

    References
    ----------
    Probabilistic Robotics, Table 4.2 (`binary_bayes_filter`) and Table 9.1 (`occupancy_grid_mapping`).
    """

    true_occupied: float = bounded(_DEFAULT[0], gt=0, lt=1)
    false_free: float = bounded(_DEFAULT[1], gt=0, lt=1)
    false_occupied: float = bounded(_DEFAULT[2], gt=0, lt=1)
    true_free: float = bounded(_DEFAULT[3], gt=0, lt=1)
    log_odds_min: float = bounded(-16.0, ge=-150, lt=0)
    log_odds_max: float = bounded(32.0, gt=0, le=150)
    log_odds_occupied: float = bounded(2.0, ge=-150, le=150)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if abs(self.true_occupied + self.false_free - 1) > 1e-9:
            raise ValueError("true_occupied and false_free must sum to 1")
        if abs(self.false_occupied + self.true_free - 1) > 1e-9:
            raise ValueError("false_occupied and true_free must sum to 1")
        if not self.true_occupied > self.false_occupied:
            raise ValueError("true_occupied must exceed false_occupied")
        if not self.log_odds_min < self.log_odds_occupied < self.log_odds_max:
            raise ValueError("log_odds_occupied must lie between log_odds_min and log_odds_max")
        evidence = self.log_odds_hit, -self.log_odds_miss
        if not (min(evidence) > 0.999 * _LEAST and max(evidence) < 1.001 * _CERTAIN):  # but for rounding
            raise ValueError(f"hit and miss must be evidence of {_LEAST} to {_CERTAIN:g} nats")

    @classmethod
    def from_log_odds(
        cls,
        hit: float,
        miss: float,
        *,
        log_odds_min: float = -16.0,
        log_odds_max: float = 32.0,
        log_odds_occupied: float = 2.0,
    ) -> InverseSensorModel:
        """Build the model whose evidence is `hit` > 0 and `miss` < 0 nats; the four probabilities follow uniquely.

        Raises
        ------
        ArgumentError
            `hit` or `miss` has the wrong sign, or is not 0.01 to 20 nats.
        """
        if not _LEAST <= hit <= _CERTAIN:
            raise ArgumentError("hit", f"{_LEAST} to {_CERTAIN} nats", hit)
        if not -_CERTAIN <= miss <= -_LEAST:
            raise ArgumentError("miss", f"{-_CERTAIN} to {-_LEAST} nats", miss)
        return cls(*_four_probabilities(hit, miss), log_odds_min, log_odds_max, log_odds_occupied)

    @property
    def log_odds_hit(self) -> float:
        """Evidence of a beam that ends in the cell, nats, > 0."""
        return math.log(self.true_occupied / self.false_occupied)

    @property
    def log_odds_miss(self) -> float:
        """Evidence of a beam that passes through the cell, nats, < 0."""
        return math.log(self.false_free / self.true_free)
