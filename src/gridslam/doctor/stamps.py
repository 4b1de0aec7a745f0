"""When the scans were taken: gaps, stamps that go backwards, stamps that repeat."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, final

from gridslam.doctor.examiner import LogHistogram, Trace, percent
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity
from gridslam.geometry.angles import wrap
from gridslam.io.measurement import Measurement

__all__ = ["StampExaminer", "StampStatistics"]

_MANY_PERIODS = 5.0  # a pause this many times as long as 9 of 10 others is none that the laser makes by itself
_BLIND_M, _BLIND_RAD = 1.0, 0.5
"""Moved unseen, this leaves a new view: a tenth of it, which odometry errs by, is a fifth of what matching reaches."""
_BLIND_S = 1.0  # without odometry the motion within a gap is not known at all
_DISORDER = 0.1  # share of backward steps: jitter of a busy recorder makes some hundredths, no order at all one half
_DEEP_S = 2.0  # a stamp so wrong puts a robot at walking pace a metre off
_RESTART_S = 10.0  # no recorder holds scans back for so long: the clock was set back, or two logs were joined
_REPEATED = 0.05  # share of stamps that repeat: each such pair has no time between, hence no speed
_KEPT = 64


class _Pause(NamedTuple):
    """Time between two scans of a laser, when it began, and the odometry motion in it (NaN: unknown)."""

    seconds: float
    began_s: float
    metres: float
    radians: float


@final
@dataclass(slots=True)
class StampStatistics:
    """The stamps of one laser."""

    scans: int = 0
    periods: LogHistogram = field(default_factory=LogHistogram)
    backward: int = 0
    repeated: int = 0
    farthest_back_s: float = 0.0
    deepest_s: float = 0.0
    first_ns: int = 0
    _last_ns: int = 0
    _latest_ns: int = 0
    _place: tuple[float, float, float] | None = None
    _pauses: list[_Pause] = field(default_factory=list)
    _trace: Trace = field(default_factory=Trace)
    _behind: Trace = field(default_factory=Trace)

    @property
    def rate_hz(self) -> float:
        """Scans a second, pauses included; NaN where there are fewer than two stamps."""
        seconds = (self._latest_ns - self.first_ns) * 1e-9
        return (self.scans - 1) / seconds if seconds > 0 else math.nan

    def take(self, stamp_ns: int, place: tuple[float, float, float] | None) -> None:
        """Take the next stamp and the odometry's x, y and theta there."""
        if not self.scans:
            self.first_ns = self._latest_ns = self._last_ns = stamp_ns
        else:
            self._compare(stamp_ns, place)
        self.scans += 1
        self._last_ns, self._latest_ns, self._place = stamp_ns, max(stamp_ns, self._latest_ns), place

    def _compare(self, stamp_ns: int, place: tuple[float, float, float] | None) -> None:
        seconds, at = (stamp_ns - self._last_ns) * 1e-9, (stamp_ns - self.first_ns) * 1e-9
        behind = (self._latest_ns - stamp_ns) * 1e-9
        self.backward += seconds < 0
        self.repeated += seconds == 0
        self.farthest_back_s = max(self.farthest_back_s, -seconds)
        self.deepest_s = max(self.deepest_s, behind)
        self._behind.add(float(self.scans), max(behind, 0.0))
        if seconds <= 0:
            return
        self.periods.add(seconds)
        self._trace.add(at, seconds)
        if len(self._pauses) < _KEPT or seconds > self._pauses[0].seconds:
            keep = heapq.heappush if len(self._pauses) < _KEPT else heapq.heapreplace
            keep(self._pauses, _Pause(seconds, at - seconds, *self._moved(place)))

    def _moved(self, place: tuple[float, float, float] | None) -> tuple[float, float]:
        if place is None or self._place is None:
            return math.nan, math.nan
        (x, y, theta), (x0, y0, theta0) = place, self._place
        return math.hypot(x - x0, y - y0), abs(float(wrap(theta - theta0)))

    def gaps(self) -> tuple[float, list[_Pause]]:
        """From how many seconds on a pause is a gap, and the longest gaps, longest first."""
        limit = max(_MANY_PERIODS * self.periods.quantile(0.9), 0.5)
        return limit, sorted((pause for pause in self._pauses if pause.seconds > limit), reverse=True)

    def pauses_figure(self, limit: float) -> Figure:
        """Time between scans over the log."""
        course = Series("time to the next scan", *self._trace.arrays(), "dots")
        return Figure("Time between scans", "time, s", "s", (course,), (Mark("gap from here on", limit),))

    def behind_figure(self) -> Figure:
        """By how much each scan is stamped before the latest one."""
        course = Series("behind the latest stamp", *self._behind.arrays())
        return Figure("Stamps that go backwards", "scan", "s", (course,))


@final
class StampExaminer:
    """Finds gaps, backward_stamps and duplicate_stamps of each laser."""

    def __init__(self) -> None:
        """Begin with no laser seen."""
        self.clocks: dict[str, StampStatistics] = {}

    def take(self, measurement: Measurement) -> None:
        """Look at the stamp of the next scan."""
        odometry, scan = measurement
        clock = self.clocks.get(scan.sensor)
        if clock is None:
            clock = self.clocks[scan.sensor] = StampStatistics()
        clock.take(scan.stamp_ns, None if odometry is None else tuple(odometry.pose.tolist()))

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the stamps."""
        for sensor, clock in self.clocks.items():
            yield from _gaps(sensor, clock)
            if clock.backward:
                yield _backward(sensor, clock)
            if clock.repeated:
                yield _repeated(sensor, clock)


def _gaps(sensor: str, clock: StampStatistics) -> Iterator[Finding]:
    limit, gaps = clock.gaps()
    if not gaps:
        return
    blind = [gap for gap in gaps if _is_blind(gap)]
    worst = max(blind, key=lambda gap: gap.seconds) if blind else gaps[0]
    count = f"{len(gaps)} gaps" if len(gaps) < _KEPT else f"{_KEPT} gaps or more"
    message = f"{'1 gap' if len(gaps) == 1 else count} in the scans; the longest lasts {gaps[0].seconds:.2f} s"
    if math.isnan(worst.metres):
        message += ", without odometry of the motion in it"
    else:
        when = "in it" if worst is gaps[0] else f"in one of {worst.seconds:.2f} s at {worst.began_s:.1f} s"
        turned = math.degrees(worst.radians)
        message += f", and {when} the robot moved {worst.metres:.2f} m and turned {turned:.0f} degrees"
    yield Finding(
        "gaps", Severity.WARNING if blind else Severity.INFO, message + ".", gaps[0].seconds, "s",
        f"Look for what stopped the recording at {worst.began_s:.1f} s (a full disk, a busy processor, a cable); map "
        "the parts by themselves, with --start and --duration, if the map breaks there." if blind else "",
        sensor, clock.pauses_figure(limit) if blind else None,
    )  # fmt: skip


def _is_blind(gap: _Pause) -> bool:
    """Whether too much may have been moved in a gap to find on by matching."""
    if math.isnan(gap.metres):
        return gap.seconds > _BLIND_S
    return gap.metres > _BLIND_M or gap.radians > _BLIND_RAD


def _backward(sensor: str, clock: StampStatistics) -> Finding:
    share = clock.backward / clock.scans
    severity = Severity.INFO
    message = f"{clock.backward} of {clock.scans} scans are stamped before the one ahead"
    message += f", by up to {clock.farthest_back_s:.3g} s"
    remedy = ""
    if clock.deepest_s > _RESTART_S:
        severity = Severity.ERROR
        message += ": the clock was set back, or several recordings were joined"
        remedy = "Map each recording by itself, with --start and --duration."
    elif clock.deepest_s > _DEEP_S or share > _DISORDER:
        severity = Severity.WARNING
        message += ": the order of the log is questionable"
        remedy = "Stamp scans when they are measured, with one clock, and record them in that order."
    else:
        message += "; it is jitter, and scans are taken in the order of the file"
    figure = clock.behind_figure() if severity is not Severity.INFO else None
    return Finding("backward_stamps", severity, message + ".", clock.farthest_back_s, "s", remedy, sensor, figure)


def _repeated(sensor: str, clock: StampStatistics) -> Finding:
    share = clock.repeated / clock.scans
    many = share > _REPEATED
    return Finding(
        "duplicate_stamps", Severity.WARNING if many else Severity.INFO,
        f"{clock.repeated} of {clock.scans} scans ({percent(share)}) have the stamp of the scan before.",
        share, "share",
        "Stamp each scan by itself, with sufficient resolution; drop scans that are sent twice." if many else "",
        sensor,
    )  # fmt: skip
