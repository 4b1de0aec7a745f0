"""Findings of the doctor, and how the checks state shares."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import final

import numpy as np

from gridslam.checked import checked


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
    """

    code: str
    severity: Severity
    message: str
    size: float | None = None
    unit: str = ""
    remedy: str = ""
    sensor: str = ""

    def __post_init__(self) -> None:
        """Turn NumPy's numbers into Python's: a finding is written as JSON."""
        if self.size is not None:
            object.__setattr__(self, "size", float(np.float64(self.size)))

    @property
    def is_fault(self) -> bool:
        """Whether it is more than information."""
        return self.severity is not Severity.INFO

    @property
    def title(self) -> str:
        """The code, and the laser that it is about."""
        return f"{self.code} ({self.sensor})" if self.sensor else self.code


def percent(share: float) -> str:
    """Format a ratio: enough digits not to print 0 % or 100 % for other values."""
    digits = 0 if 0.1 <= share <= 0.9 or share in (0.0, 1.0) else 1 if 0.001 <= share <= 0.999 else 3
    return f"{100 * share:.{digits}f} %"
