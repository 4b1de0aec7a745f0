"""Result of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from gridslam.doctor.beams import BeamStatistics
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.lasers import Mounted
from gridslam.doctor.range_limits import RangeCounts
from gridslam.doctor.stamps import StampStatistics
from gridslam.io.log_statistics import LogStatistics
from gridslam.types import FloatArray

__all__ = ["Diagnosis", "LaserFacts"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class LaserFacts:
    """What is known of one laser.

    Attributes
    ----------
    scans : int
    rate_hz : float or None
        Scans a second, pauses included.
    beams : int
        That most of its scans have.
    field_of_view_rad : float
    clockwise : bool
        Whether its bearings fall from the first beam to the last.
    range_min_m, range_max_m : float
        Limits as stated; the greatest may be infinite.
    invalid_share, no_return_share : float
        Of all beams.
    mounting : (3,) float64
        As stated: [x m, y m, yaw rad] in the base frame.
    tilt_rad : float
        From level.
    upside_down : bool
    """

    scans: int
    rate_hz: float | None
    beams: int
    field_of_view_rad: float
    clockwise: bool
    range_min_m: float
    range_max_m: float
    invalid_share: float
    no_return_share: float
    mounting: FloatArray
    tilt_rad: float
    upside_down: bool

    @classmethod
    def of(cls, clock: StampStatistics, sweep: BeamStatistics, limits: RangeCounts, mounted: Mounted) -> LaserFacts:
        """Gather what the examiners saw of one laser."""
        beams, rate_hz = max(sweep.beams, 1), clock.rate_hz
        return cls(
            sweep.scans, rate_hz if math.isfinite(rate_hz) else None, sweep.usual_count, sweep.field_of_view_rad,
            sweep.clockwise, limits.range_min_m, limits.range_max_m, sweep.invalid / beams, sweep.no_return / beams,
            mounted.pose, mounted.tilt_rad, mounted.upside_down,
        )  # fmt: skip


@final
@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All findings of a log, the worst first, and its facts.

    Attributes
    ----------
    path : Path
    findings : tuple of Finding
        Sorted by severity: spoils, doubtful, info.
    lasers : mapping of str to LaserFacts
        By sensor.
    statistics : LogStatistics
        What the reader met.
    metres, radians : float
        Path length and rotation of the odometry.
    """

    path: Path
    findings: tuple[Finding, ...]
    lasers: Mapping[str, LaserFacts]
    statistics: LogStatistics
    metres: float
    radians: float

    @classmethod
    def of(
        cls, path: Path, findings: Sequence[Finding], lasers: Mapping[str, LaserFacts], statistics: LogStatistics,
        metres: float, radians: float,
    ) -> Diagnosis:  # fmt: skip
        """Sort the findings: worst first, else as they came."""
        ordered = sorted(findings, key=lambda finding: -finding.severity.rank)
        return cls(path, tuple(ordered), lasers, statistics, metres, radians)

    def __repr__(self) -> str:
        """Return one line."""
        codes = ", ".join(finding.code for finding in self.faults[:5]) + ", ..." * (len(self.faults) > 5)
        return f"Diagnosis({self.path.name}: {self.worst.value}; {len(self.faults)} faults{': ' * bool(codes)}{codes})"

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that are more than information."""
        return tuple(finding for finding in self.findings if finding.is_fault)

    @property
    def worst(self) -> Severity:
        """How bad the worst finding is."""
        return self.findings[0].severity if self.findings else Severity.INFO
