"""When the scans were taken: gaps, stamps that go backwards, stamps that repeat."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.geometry.angles import wrap
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, describe_duration

_MANY_PERIODS = 5.0  # a pause this many times as long as 9 of 10 others is none that the laser makes by itself
_BLIND_M = 1.0
_BLIND_RAD = 0.5
"""An unseen motion of this size gives a new view: the odometry's error, a tenth, is a fifth of the matcher's reach."""
_BLIND_S = 1.0  # without odometry the motion within a gap is not known at all
_DISORDER = 0.1  # share of backward steps: jitter of a busy recorder makes some hundredths, no order at all one half
_DEEP_S = 2.0  # a stamp so wrong puts a robot at walking pace a metre off
_RESTART_S = 10.0  # no recorder holds scans back for so long: the clock was set back, or two logs were joined
_REPEATED = 0.05  # share of stamps that repeat: each such pair has no time between, hence no speed


class _Pause(NamedTuple):
    """Time between two scans of a laser, when it began, and the odometry motion in it (NaN: unknown)."""

    seconds: float
    began_s: float
    metres: float
    radians: float


@final
@dataclass(slots=True)
class StampStatistics:
    """The stamps of one laser: finds gaps, backward_stamps and duplicate_stamps."""

    scans: int = 0
    backward: int = 0
    repeated: int = 0
    farthest_back_s: float = 0.0
    deepest_s: float = 0.0
    first_ns: int = 0
    _last_ns: int = 0
    _latest_ns: int = 0
    _pose: FloatArray | None = None
    _pauses: array[float] = field(default_factory=lambda: array("d"))
    """The values of a `_Pause` for each scan that is later than the one before."""

    @property
    def rate_hz(self) -> float:
        """Scans a second, pauses included; NaN where there are fewer than two stamps."""
        seconds = (self._latest_ns - self.first_ns) * 1e-9
        return (self.scans - 1) / seconds if seconds > 0 else math.nan

    def take(self, measurement: Measurement) -> None:
        """Take the stamp of the next scan, and the odometry there."""
        stamp_ns = measurement.scan.stamp_ns
        pose = None if measurement.odometry is None else measurement.odometry.pose
        if self.scans:
            self._compare(stamp_ns, pose)
        else:
            self.first_ns = self._latest_ns = stamp_ns
        self.scans += 1
        self._last_ns = stamp_ns
        self._latest_ns = max(stamp_ns, self._latest_ns)
        self._pose = pose

    def _compare(self, stamp_ns: int, pose: FloatArray | None) -> None:
        seconds = (stamp_ns - self._last_ns) * 1e-9
        behind = (self._latest_ns - stamp_ns) * 1e-9
        self.backward += seconds < 0
        self.repeated += seconds == 0
        self.farthest_back_s = max(self.farthest_back_s, -seconds)
        self.deepest_s = max(self.deepest_s, behind)
        if seconds <= 0:
            return
        at = (stamp_ns - self.first_ns) * 1e-9
        x, y, theta = (math.nan,) * 3 if pose is None or self._pose is None else (pose - self._pose).tolist()
        self._pauses.extend(_Pause(seconds, at - seconds, math.hypot(x, y), abs(float(wrap(theta)))))

    def gaps(self) -> list[_Pause]:
        """Return the longest gaps, longest first."""
        pauses = np.array(self._pauses).reshape(-1, len(_Pause._fields))
        if not len(pauses):
            return []
        limit = max(_MANY_PERIODS * float(np.quantile(pauses[:, 0], 0.9)), 0.5)
        return sorted(map(_Pause._make, pauses[pauses[:, 0] > limit].tolist()), reverse=True)

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the findings on the stamps of the laser of that name."""
        gaps = self.gaps()
        if gaps:
            yield _gaps(sensor, gaps)
        if self.backward:
            yield self._backward(sensor)
        if self.repeated:
            yield self._repeated(sensor)

    def _backward(self, sensor: str) -> Finding:
        share = self.backward / self.scans
        if self.deepest_s > _RESTART_S:
            severity = Severity.ERROR
            meaning = ": the clock was set back, or several recordings were joined"
            remedy = "Map each recording by itself, with --start and --duration."
        elif self.deepest_s > _DEEP_S or share > _DISORDER:
            severity = Severity.WARNING
            meaning = ": the order of the log is questionable"
            remedy = "Stamp scans when they are measured, with one clock, and record them in that order."
        else:
            severity = Severity.INFO
            meaning = "; it is jitter, and scans are taken in the order of the file"
            remedy = ""
        return Finding(
            "backward_stamps",
            severity,
            f"{self.backward} of {self.scans} scans are stamped before the one ahead, by up to "
            f"{describe_duration(self.farthest_back_s)}{meaning}.",
            self.farthest_back_s,
            "s",
            remedy,
            sensor,
        )

    def _repeated(self, sensor: str) -> Finding:
        share = self.repeated / self.scans
        many = share > _REPEATED
        return Finding(
            "duplicate_stamps",
            Severity.WARNING if many else Severity.INFO,
            f"{self.repeated} of {self.scans} scans ({percent(share)}) have the stamp of the scan before.",
            share,
            "share",
            "Stamp each scan by itself, with sufficient resolution; drop scans that are sent twice." if many else "",
            sensor,
        )


def _gaps(sensor: str, gaps: list[_Pause]) -> Finding:
    blind = [gap for gap in gaps if _is_blind(gap)]
    worst = max(blind, key=lambda gap: gap.seconds) if blind else gaps[0]
    count = f"{len(gaps)} gap{'s' * (len(gaps) != 1)}"
    message = f"{count} in the scans; the longest lasts {describe_duration(gaps[0].seconds)}"
    if math.isnan(worst.metres):
        message += ", without odometry of the motion in it"
    else:
        when = "in it" if worst is gaps[0] else f"in one of {describe_duration(worst.seconds)} at {worst.began_s:.1f} s"
        turned = math.degrees(worst.radians)
        message += f", and {when} the robot moved {worst.metres:.2f} m and turned {turned:.0f} degrees"
    return Finding(
        "gaps",
        Severity.WARNING if blind else Severity.INFO,
        message + ".",
        gaps[0].seconds,
        "s",
        f"Look for what stopped the recording at {worst.began_s:.1f} s (a full disk, a busy processor, a cable); map "
        "the parts by themselves, with --start and --duration, if the map breaks there."
        if blind
        else "",
        sensor,
    )


def _is_blind(gap: _Pause) -> bool:
    """Return whether too much may have been moved in a gap to find on by matching."""
    if math.isnan(gap.metres):
        return gap.seconds > _BLIND_S
    return gap.metres > _BLIND_M or gap.radians > _BLIND_RAD
