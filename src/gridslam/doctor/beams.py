"""Statistics of the beams of each laser: number, directions, and invalid beams."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.examiner import Trace, percent
from gridslam.doctor.finding import Figure, Finding, Series, Severity
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan, ScanGeometry

__all__ = ["BeamExaminer", "BeamStatistics", "field_of_view_rad", "is_clockwise"]

_MANY_LOST = 0.1  # ratio of beams lost by ones and twos: the pose's spread grows by 5 %; healthy: some thousandths
_LONGEST_LOSS = 3  # beams: a longer run is a surface, or nothing in reach; beams are lost by chance one by one
_FEW_HITS = 20  # beams: fewer hardly fix x, y and heading against people and clutter
_OFTEN = 0.1  # share of scans with few hits from which on the map has holes; and half of them leaves no map
_ALWAYS = 0.99  # a beam that is invalid this often is blocked, it is not lost by chance
_INVALID, _NO_RETURN, _HIT = (np.uint8(s) for s in (BeamStatus.INVALID, BeamStatus.NO_RETURN, BeamStatus.HIT))


def field_of_view_rad(bearings: FloatArray) -> float:
    """Angle over which beams with bearings (B,) are spread, one step for each beam, at most a full turn."""
    if len(bearings) < 2:
        return 0.0
    return min(abs(float(bearings[-1] - bearings[0])) * len(bearings) / (len(bearings) - 1), math.tau)


def is_clockwise(bearings: FloatArray) -> bool:
    """Whether bearings (B,) fall from the first to the last."""
    return len(bearings) > 1 and bool(bearings[0] > bearings[-1])


@final
@dataclass(slots=True)
class BeamStatistics:
    """The beams of one laser, over all its scans."""

    scans: int = 0
    counts: Counter[int] = field(default_factory=Counter)
    beams: int = 0
    invalid: int = 0
    no_return: int = 0
    not_numbers: int = 0
    zeros: int = 0
    scattered: int = 0
    scans_without_hits: int = 0
    geometry: ScanGeometry | None = None
    _lost: dict[int, IntArray] = field(default_factory=dict)
    _invalid_trace: Trace = field(default_factory=Trace)
    _count_trace: Trace = field(default_factory=Trace)

    def take(self, scan: LaserScan) -> None:
        """Take the beams of the next scan."""
        count, status = len(scan), scan.status
        lost = status == _INVALID
        invalid, hits = int(np.count_nonzero(lost)), int(np.count_nonzero(status == _HIT))
        self.geometry = scan.geometry
        self.counts[count] += 1
        self.beams += count
        self.invalid += invalid
        self.no_return += count - invalid - hits
        self.scans_without_hits += hits < _FEW_HITS
        self._invalid_trace.add(float(self.scans), invalid / max(count, 1))
        self._count_trace.add(float(self.scans), float(count))
        self.scans += 1
        if invalid:
            self._note_lost(scan, lost)

    def _note_lost(self, scan: LaserScan, lost: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> None:
        readings = scan.ranges[lost]
        self.not_numbers += int(np.count_nonzero(np.isnan(readings)))
        self.zeros += int(np.count_nonzero(readings == 0))
        edges = np.flatnonzero(np.diff(lost, prepend=False, append=False))
        runs = edges[1::2] - edges[::2]
        self.scattered += int(runs[runs <= _LONGEST_LOSS].sum())
        if len(scan) not in self._lost and len(self._lost) < 16:
            self._lost[len(scan)] = np.zeros(len(scan), np.int64)
        if (known := self._lost.get(len(scan))) is not None:
            known += lost

    @property
    def usual_count(self) -> int:
        """The number of beams that most scans have."""
        return self.counts.most_common(1)[0][0] if self.counts else 0

    @property
    def field_of_view_rad(self) -> float:
        """Angle over which the beams of the latest scan are spread, at most a full turn."""
        return 0.0 if self.geometry is None else field_of_view_rad(self.geometry.bearings)

    @property
    def clockwise(self) -> bool:
        """Whether bearings fall from the first beam to the last."""
        return self.geometry is not None and is_clockwise(self.geometry.bearings)

    def count_blocked_beams(self) -> int:
        """How many beams of the usual scan never measure anything."""
        lost = self._lost.get(self.usual_count)
        return 0 if lost is None else int(np.count_nonzero(lost >= _ALWAYS * self.counts[self.usual_count]))

    def invalid_figure(self) -> Figure:
        """Ratio of invalid beams over the log."""
        course = Series("ratio of the beams of a scan", *self._invalid_trace.arrays())
        return Figure("Invalid beams", "scan", "share", (course,), ())

    def counts_figure(self) -> Figure:
        """How many scans have how many beams."""
        counts = np.array(sorted(self.counts.items()), np.float64)
        return Figure("Beams of a scan", "beams", "scans", (Series("scans", counts[:, 0], counts[:, 1], "bars"),))


@final
class BeamExaminer:
    """Finds beam_count_varies, invalid_beams and few_hits of each laser."""

    def __init__(self) -> None:
        """Begin with no laser seen."""
        self.sweeps: dict[str, BeamStatistics] = {}

    def take(self, measurement: Measurement) -> None:
        """Look at the beams of the next scan."""
        scan = measurement.scan
        sweep = self.sweeps.get(scan.sensor)
        if sweep is None:
            sweep = self.sweeps[scan.sensor] = BeamStatistics()
        sweep.take(scan)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the beams."""
        for sensor, sweep in self.sweeps.items():
            if len(sweep.counts) > 1:
                yield _varies(sensor, sweep)
            if sweep.invalid:
                yield _invalid(sensor, sweep)
            if sweep.scans_without_hits > _OFTEN * sweep.scans:
                yield _few_hits(sensor, sweep)


def _varies(sensor: str, sweep: BeamStatistics) -> Finding:
    least, most = min(sweep.counts), max(sweep.counts)
    return Finding(
        "beam_count_varies", Severity.WARNING,
        f"The number of beams varies from {least} to {most}; {sweep.counts[sweep.usual_count]} of {sweep.scans} scans "
        f"have {sweep.usual_count}.",
        most - least, "beams",
        "gridslam uses the angles of each scan: make sure that the driver sets angle_min and angle_increment "
        "for each scan, since a fixed increment with a varying number of beams bends the walls.",
        sensor, sweep.counts_figure(),
    )  # fmt: skip


def _invalid(sensor: str, sweep: BeamStatistics) -> Finding:
    share, scattered = sweep.invalid / sweep.beams, sweep.scattered / sweep.beams
    many = scattered > _MANY_LOST
    kinds = [("not a number", sweep.not_numbers), ("zero", sweep.zeros),
             ("negative or too near", sweep.invalid - sweep.not_numbers - sweep.zeros)]  # fmt: skip
    told = ", ".join(f"{percent(count / sweep.beams)} {kind}" for kind, count in kinds if count)
    message = f"{percent(share)} of the beams are invalid ({told})"
    if many:
        message += f"; {percent(scattered)} are lost by ones and twos among good ones, as where a laser is disturbed"
    elif share > _MANY_LOST:
        message += "; they lie side by side, as where nothing is in reach or the robot hides the view"
    if blocked := sweep.count_blocked_beams():
        message += f"; {blocked} of {sweep.usual_count} beams never measure anything"
    remedy = "Clean the laser, and look for what disturbs it: sun, dark or shining surfaces, another laser, a cable."
    return Finding(
        "invalid_beams", Severity.WARNING if many else Severity.INFO, message + ".", share, "share",
        remedy if many else "", sensor, sweep.invalid_figure() if many else None,
    )  # fmt: skip


def _few_hits(sensor: str, sweep: BeamStatistics) -> Finding:
    share = sweep.scans_without_hits / sweep.scans
    return Finding(
        "few_hits", Severity.ERROR if share > 0.5 else Severity.WARNING,
        f"{percent(share)} of the scans have fewer than {_FEW_HITS} beams that hit anything "
        f"({percent(sweep.no_return / max(sweep.beams, 1))} of all beams return nothing, "
        f"{percent(sweep.invalid / max(sweep.beams, 1))} are invalid): they cannot be matched.",
        share, "share",
        "Drive where walls are within the laser's reach, and check its range limits.", sensor,
    )  # fmt: skip
