"""What looks at a log as it passes by, and what several of those need."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, final

import numpy as np

from gridslam.doctor.finding import Finding
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, IntArray

__all__ = ["Examiner", "LogHistogram", "Trace", "percent"]


class Examiner(Protocol):
    """Sees every measurement of a log once, in its order, in memory that does not grow with the log."""

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""

    def findings(self) -> Iterator[Finding]:
        """Yield the findings so far."""


@final
class LogHistogram:
    """Counts of positive numbers in bins 5 % wide, from 1e-6 to 1e6: quantiles within 2.5 % in 4 kB.

    Numbers outside are counted in the first and the last bin.
    """

    __slots__ = ("_counts", "total")

    _WIDTH, _LOW, _BINS = float(np.log(1.05)), float(np.log(1e-6)), 567

    def __init__(self) -> None:
        """Begin with nothing counted."""
        self._counts: IntArray = np.zeros(self._BINS, np.int64)
        self.total = 0

    def add(self, value: float) -> None:
        """Count one number > 0."""
        place = int((np.log(value) - self._LOW) / self._WIDTH) if value > 0 else 0
        self._counts[min(max(place, 0), self._BINS - 1)] += 1
        self.total += 1

    def quantile(self, share: float) -> float:
        """Number below which so large a share of the numbers lies; NaN where there are none."""
        if not self.total:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self._counts), share * self.total))
        return float(np.exp(self._LOW + self._WIDTH * (place + 0.5)))


@final
class Trace:
    """A course of values over time for a picture, kept as the greatest value of each of at most 2000 stretches."""

    __slots__ = ("_count", "_each", "_times", "_values")

    _MOST = 2000

    def __init__(self) -> None:
        """Begin with nothing kept, one value a stretch."""
        self._times: list[float] = []
        self._values: list[float] = []
        self._each, self._count = 1, 0

    def add(self, time: float, value: float) -> None:
        """Take the next value."""
        if self._count % self._each == 0:
            self._times.append(time)
            self._values.append(value)
        elif value > self._values[-1]:
            self._times[-1], self._values[-1] = time, value
        self._count += 1
        if len(self._values) > self._MOST:
            self._halve()

    def _halve(self) -> None:
        later = [k + (k + 1 < len(self._values) and self._values[k + 1] > self._values[k])
                 for k in range(0, len(self._values), 2)]  # fmt: skip
        self._times, self._values = [self._times[k] for k in later], [self._values[k] for k in later]
        self._count = self._each * 2 * (len(later) - 1) + 1
        self._each *= 2

    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """Times (K,) and values (K,), in the order they came."""
        return np.array(self._times), np.array(self._values)


def percent(share: float) -> str:
    """Format a ratio: enough digits not to print 0 % or 100 % for other values."""
    digits = 0 if 0.1 <= share <= 0.9 or share in (0.0, 1.0) else 1 if 0.001 <= share <= 0.999 else 3
    return f"{100 * share:.{digits}f} %"
