"""Findings of the doctor, their figures, and helpers of the checks that look for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import final

import numpy as np

from gridslam.checked import checked
from gridslam.types import FloatArray

__all__ = ["Figure", "Finding", "Mark", "Series", "Severity", "Trace", "percent"]


class Severity(Enum):
    """How much a finding matters to the map."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def rank(self) -> int:
        """0 for information, 1 for a warning, 2 for a fault that makes the map unusable."""
        return list(Severity).index(self)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Points (K,) and (K,) of a figure, joined by a line or drawn as dots or as bars from zero."""

    name: str
    x: FloatArray
    y: FloatArray
    style: str = "line"


@final
@dataclass(frozen=True, slots=True)
class Mark:
    """A line across a figure at a value of x or of y, with its meaning."""

    name: str
    value: float
    axis: str = "y"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """The data of a figure of a finding, independent of how it is drawn.

    Attributes
    ----------
    title, x_label, y_label : str
        The labels with their units.
    series : tuple of Series
        At least one.
    marks : tuple of Mark
        Limits and measured values.
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    marks: tuple[Mark, ...] = ()


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One thing that the doctor found.

    Attributes
    ----------
    code : str
        Stable name, see docs/doctor.md.
    severity : Severity
        Only what is doubtful or worse is a fault.
    message : str
        One plain sentence, with numbers.
    size : float or None
        How large it is, in `unit`; finite.
    unit : str
        Of the size: "s", "m", "rad", "share", "1" ...
    remedy : str
        One sentence: the command-line option, or what to change on the robot; empty where nothing is to be done.
    sensor : str
        The laser it is about; empty where it is about the whole log.
    figure : Figure or None
        Where a picture helps.
    """

    code: str
    severity: Severity
    message: str
    size: float | None = None
    unit: str = ""
    remedy: str = ""
    sensor: str = ""
    figure: Figure | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Turn NumPy's numbers into Python's: a finding is written as JSON."""
        if self.size is not None:
            object.__setattr__(self, "size", float(np.float64(self.size)))

    @property
    def is_fault(self) -> bool:
        """Whether it is more than information."""
        return self.severity is not Severity.INFO


@final
class Trace:
    """A course of values over time for a picture, kept as the greatest value of each of at most 2000 stretches."""

    __slots__ = ("_count", "_each", "_times", "_values")

    _MOST = 2000

    def __init__(self) -> None:
        """Begin with nothing kept, one value a stretch."""
        self._times: list[float] = []
        self._values: list[float] = []
        self._each = 1
        self._count = 0

    def add(self, time: float, value: float) -> None:
        """Take the next value."""
        if self._count % self._each == 0:
            self._times.append(time)
            self._values.append(value)
        elif value > self._values[-1]:
            self._times[-1] = time
            self._values[-1] = value
        self._count += 1
        if len(self._values) > self._MOST:  # keep the greater of each two stretches
            greater = [
                max(range(k, min(k + 2, len(self._values))), key=self._values.__getitem__)
                for k in range(0, len(self._values), 2)
            ]
            self._times = [self._times[k] for k in greater]
            self._values = [self._values[k] for k in greater]
            self._each *= 2
            self._count = self._each * (len(greater) - 1) + 1

    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """Return times (K,) and values (K,), in the order they came."""
        return np.array(self._times), np.array(self._values)


def percent(share: float) -> str:
    """Format a ratio: enough digits not to print 0 % or 100 % for other values."""
    digits = 0 if 0.1 <= share <= 0.9 or share in (0.0, 1.0) else 1 if 0.001 <= share <= 0.999 else 3
    return f"{100 * share:.{digits}f} %"
