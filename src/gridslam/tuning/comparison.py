"""Is a configuration better than another one beyond the noise of seeds and logs? Paired, on runs that chose neither."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.types import FloatArray

CONFIDENCE = 0.95

_LOGS_AS_UNITS = 4
"""From this many logs on the mean of each log is one observation: the question is about other logs, and seeds of one
log are no independent evidence. With fewer, each pair of runs is one, and the answer holds for these logs."""

_FAILED = math.log(10.0)
"""Difference that is counted where one configuration fails and the other does not: an error ten times as large."""


@final
class Pair(NamedTuple):
    """Logarithms of the losses of two configurations on one log with one seed; infinite where a run failed."""

    log: str
    seed: int
    base: float
    tuned: float


@final
@dataclass(frozen=True, slots=True)
class Comparison:
    """A configuration against the one that the search began with.

    Attributes
    ----------
    ratio : float
        Its loss as a ratio to the other's, geometric mean; below 1 is better.
    lower, upper : float
        95 % interval of the ratio by Student's t; infinite where there are not two observations.
    units : str
        What the observations are: "logs", or "runs".
    observations : int
        Their number.
    failed : int
        Runs of the tuned configuration that failed.
    """

    ratio: float
    lower: float
    upper: float
    units: str
    observations: int
    failed: int

    @property
    def gains(self) -> bool:
        """Whether it is better beyond the noise."""
        return self.upper < 1 and not self.failed


def compare(pairs: Sequence[Pair]) -> Comparison:
    """Compare two configurations by runs with the same logs and seeds.

    Raises ArgumentError where there is no pair.
    """
    if not pairs:
        raise ArgumentError("pairs", "at least one", "none")
    of_log = defaultdict[str, list[float]](list)
    for pair in pairs:
        of_log[pair.log].append(_difference(pair))
    by_log = len(of_log) >= _LOGS_AS_UNITS
    observed = np.array(
        [np.mean(of) for of in of_log.values()] if by_log else [one for of in of_log.values() for one in of]
    )
    mean = float(observed.mean())
    half = _half_width(observed)
    return Comparison(
        ratio=math.exp(mean),
        lower=math.exp(mean - half),
        upper=math.exp(mean + half),
        units="logs" if by_log else "runs",
        observations=len(observed),
        failed=sum(math.isinf(pair.tuned) for pair in pairs),
    )


def _difference(pair: Pair) -> float:
    failed = math.isinf(pair.base), math.isinf(pair.tuned)
    if any(failed):
        return _FAILED * (failed[1] - failed[0])
    return pair.tuned - pair.base


def _half_width(observed: FloatArray) -> float:
    """Half the confidence interval of the mean."""
    if len(observed) < 2:
        return math.inf
    from scipy.special import stdtrit

    quantile = float(stdtrit(len(observed) - 1, (1 + CONFIDENCE) / 2))
    return quantile * float(observed.std(ddof=1)) / math.sqrt(len(observed))
