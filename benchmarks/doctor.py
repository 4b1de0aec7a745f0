"""What the whole doctor finds: single faults over simulated logs of many kinds, and none in the same logs clean.

python benchmarks/doctor.py [--first 0] [--seeds 20] [--only clock_skew ...] [--verbose]
"""

from __future__ import annotations

import argparse
import functools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.doctor import diagnose
from gridslam.doctor.finding import Finding
from gridslam.geometry.angles import wrap
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from report import Report, Target, table
from support.faults import FAULTS, with_fault

__all__ = ["CASES", "MadeLog", "any_log", "doctor"]

_WORLDS = ("demo", "random", "loop", "rooms", "hall")
_CLOSE = 0.2
_HEAD = ["fault", "size", "named", "within 20 %", "median error", "worst", "other faults told", "CPU s", "longest"]


class MadeLog:
    """Measurements in memory, read as a log is."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        """Nothing is counted before the iteration."""
        self.path = Path("simulated")
        self.statistics = LogStatistics()
        self._measurements = measurements

    def __iter__(self) -> Iterator[Measurement]:
        """Read and count."""
        self.statistics = LogStatistics()
        for measurement in self._measurements:
            self.statistics.count(measurement)
            yield measurement


class Drawn(NamedTuple):
    """A log and its truth."""

    measurements: Sequence[Measurement]
    truth: np.ndarray
    scan_time_s: float


class Case(NamedTuple):
    """A fault: the log it is put in, and its size there (of none where only the name counts).

    What is `told` is a finding of whatever severity; else it must be a fault.
    """

    make: Callable[[int], Drawn]
    size: Callable[[Drawn], float | None]
    code: str
    told: bool = False


@functools.cache
def any_log(seed: int, *, lasers: int = 1, omega_rad_s: float | None = None, beams: int | None = None) -> Drawn:
    """Draw a log: 180 to 720 beams over 180 to 360 degrees at 5 to 20 Hz, noise of 1 to 3 cm, 30 to 200 m.

    Odometry errs by chance only, half to one and a half times as much as by default. A second laser looks backward.
    Where a turn rate is given, beams are measured one after the other and tell their times.
    """
    rng = np.random.default_rng([seed, 4])
    drawn, span = int(rng.integers(180, 721)), math.pi * float(rng.choice([1.0, 1.5, 2.0]))
    rate = float(rng.choice([5.0, 8.0, 10.0, 12.5, 20.0]))
    sigma, x = float(rng.uniform(0.01, 0.03)), float(rng.uniform(-0.1, 0.25))
    sweep = 0.0 if omega_rad_s is None else span / math.tau / rate
    lidars = [
        LidarConfig(
            beams=beams or drawn,
            field_of_view_rad=span,
            rate_hz=rate,
            sigma_range_m=sigma,
            x_m=x - 0.3 * k,
            heading_rad=math.pi * k,
            begin_s=0.4 * k / rate,
            sensor=("front", "rear")[k],
            scan_time_s=sweep,
        )
        for k in range(lasers)
    ]
    speed = float(rng.uniform(0.4, 0.9))
    omega = float(rng.uniform(0.7, 1.5))
    robot = RobotConfig(v_max_m_s=speed, omega_max_rad_s=omega_rad_s or omega, acceleration_m_s2=speed)
    chance = float(rng.uniform(0.5, 1.5))
    noise = OdometryNoise(
        distance_scale=1.0,
        turn_scale=1.0,
        bias_rad_per_m=0.0,
        alpha1=2e-4 * chance,
        alpha2=1e-4 * chance,
        alpha3=2e-4 * chance,
        alpha4=1e-4 * chance,
    )
    log = simulate(make_world(_WORLDS[seed % len(_WORLDS)], rng), robot, noise, lidars, rng)
    return _first(log, float(rng.uniform(30, 200)), sweep)


def _first(log: SimulatedLog, longest: float, sweep: float) -> Drawn:
    """The log's first so many metres."""
    metres = np.cumsum(np.hypot(*np.diff(log.truth.poses[:, :2], axis=0, prepend=log.truth.poses[:1, :2]).T))
    pairs = takewhile(lambda pair: pair[0] < longest, zip(metres.tolist(), log.measurements, strict=True))
    kept = [measurement for _, measurement in pairs]
    return Drawn(kept, log.truth.poses[: len(kept)], sweep)


def _spoilt(code: str, *, told: bool = False, **how: int) -> Case:
    """A fault of `support.faults` of its usual size, in a log that has no other."""

    def make(seed: int) -> Drawn:
        log = any_log(seed, **how)
        return log._replace(measurements=list(with_fault(log.measurements, code, np.random.default_rng(seed))))

    return Case(make, lambda log: None if code == "reflected_laser" else FAULTS[code].size, code, told)


def _untimed(seed: int) -> Drawn:
    """A log whose beams are measured one after the other, and which does not tell when."""
    log = any_log(seed, omega_rad_s=3.0)
    return log._replace(measurements=[m._replace(scan=replace(m.scan, beam_times_s=None)) for m in log.measurements])


def _smear_rad(log: Drawn) -> float:
    """The turn in a scan: what 0.998 of the scans do not exceed."""
    times = np.array([scan.stamp_ns for _, scan in log.measurements]) * 1e-9
    rates = np.abs(wrap(np.diff(log.truth[:, 2]))) / np.diff(times)
    return float(np.quantile(rates, 0.998)) * log.scan_time_s


CASES: Mapping[str, Case] = {
    "clean": Case(any_log, lambda _: None, ""),
    **{code: _spoilt(code) for code in ("reflected_laser", "yaw_offset")},
    "clock_skew": _spoilt("clock_skew", told=True),
    "odometry_scale": _spoilt("odometry_scale"),
    "beam_count_varies": _spoilt("beam_count_varies", beams=460),
    "invalid_beams": _spoilt("invalid_beams"),
    "two lasers": Case(lambda seed: any_log(seed, lasers=2), lambda _: 2.0, "several_lasers", told=True),
    "3 rad/s, with beam times": Case(
        lambda seed: any_log(seed, omega_rad_s=3.0), _smear_rad, "skewed_while_turning", told=True
    ),
    "3 rad/s, without": Case(_untimed, _smear_rad, "skewed_while_turning"),
    **{code: _spoilt(code) for code in ("odometry_rotation_bias", "odometry_drift", "wheel_slip")},
}
"""By name; the first eight after `clean` are those that must be named in 19 of 20 logs."""


def doctor(report: Report, seeds: Sequence[int], cases: Iterable[str] = tuple(CASES), verbose: bool = False) -> None:
    """Diagnose each log with each fault in turn, and with none; add one table and its targets to the report."""
    rows = [_row(name, CASES[name], seeds, report, verbose) for name in cases]
    report.sections.append(f"## What the doctor finds: seeds {seeds[0]} to {seeds[-1]}\n\n{table(_HEAD, rows)}")


def _row(name: str, case: Case, seeds: Sequence[int], report: Report, verbose: bool) -> list[object]:
    errors, others, spent, sizes = [], [], [], []
    for seed in seeds:
        drawn = case.make(seed)
        began = time.process_time()
        findings = diagnose(MadeLog(drawn.measurements)).findings
        spent.append(time.process_time() - began)
        true = case.size(drawn)
        named = next((f for f in findings if f.code == case.code and (f.is_fault or case.told)), None)
        faults = [f"{f.code} {f.size:.3g}" for f in findings if f.is_fault and f is not named and f.size is not None]
        others += faults
        errors.append(_error(named, true))
        sizes.append(true or 0.0)
        if verbose:
            print(name, seed, true, named and named.size, faults, f"{spent[-1]:.2f} s", flush=True)
    close = sum(error <= _CLOSE for error in errors)
    if case.code:
        report.targets.append(Target(f"{name}: logs not named in size", len(errors) - close, len(errors) // 20))
    report.targets.append(Target(f"{name}: other faults told", len(others), 0))
    known = [error for error in errors if math.isfinite(error)] or [math.nan]
    return [
        name,
        statistics.median(sizes),
        len(known) if case.code else 0,
        close,
        statistics.median(known),
        max(known),
        ", ".join(sorted(others)) or "none",
        statistics.median(spent),
        max(spent),
    ]


def _error(finding: Finding | None, true: float | None) -> float:
    """Relative error of the size; 0 where only the name counts, infinite where the fault was not named."""
    if finding is None or finding.size is None:
        return math.inf
    if true is None:
        return 0.0
    apart = float(wrap(finding.size - true)) if finding.code == "yaw_offset" else finding.size - true
    return abs(apart / true)


def main() -> None:
    """Run it and print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=20, help="how many")
    parser.add_argument("--only", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    report = Report()
    doctor(report, range(options.first, options.first + options.seeds), options.only, options.verbose)
    print(*report.sections, report.summary(), sep="\n\n")


if __name__ == "__main__":
    main()
