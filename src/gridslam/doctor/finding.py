"""Findings of the doctor, and their figures."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import final

import numpy as np

from gridslam.types import FloatArray

__all__ = ["Figure", "Finding", "Mark", "Series", "Severity"]


class Severity(Enum):
    """How much a finding matters to the map."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def rank(self) -> int:
        """0 for information, 1 for a warning, 2 for a fault that makes the map unusable."""
        return _RANKS[self]


_RANKS = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}


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
    """A line across a figure, at a value of x or of y, with what it means."""

    name: str
    value: float
    axis: str = "y"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """What a picture of a finding shows; who draws it decides how.

    Attributes
    ----------
    title, x_label, y_label : str
        The labels with their units.
    series : tuple of Series
        At least one.
    marks : tuple of Mark
        Limits and measured values.
    equal : bool
        Whether both axes have the same scale, as for points in the plane.
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    marks: tuple[Mark, ...] = ()
    equal: bool = False


@final
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
