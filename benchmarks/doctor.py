"""What the doctor finds by motion: single faults over simulated logs of many kinds, and none in the same logs clean.

python benchmarks/doctor.py [--seeds 20] [--only clock_skew ...] [--verbose]
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterable, Sequence
from itertools import takewhile

import numpy as np

from gridslam.doctor.calibration import calibrate
from gridslam.doctor.finding import Finding
from gridslam.doctor.laser_motion import laser_motion
from gridslam.doctor.motion_findings import motion_findings
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.sim.faults import FAULTS, with_fault
from report import Report, Target, table

__all__ = ["FAULTS_OF_MOTION", "any_log", "doctor", "told"]

FAULTS_OF_MOTION = (
    "reflected_laser", "yaw_offset", "clock_skew", "odometry_scale", "odometry_rotation_bias", "odometry_drift",
    "wheel_slip",
)  # fmt: skip
_WORLDS = ("demo", "random", "loop", "rooms", "hall")
_CLOSE = 0.2
_HEAD = ["fault", "size", "named", "within 20 %", "median error", "worst", "other faults told", "CPU s", "longest"]


def any_log(seed: int) -> list[Measurement]:
    """Draw a log: 180 to 720 beams over 180 to 360 degrees at 5 to 20 Hz, noise of 1 to 3 cm, 30 to 200 m.

    Odometry errs by chance only, half to one and a half times as much as by default.
    """
    rng = np.random.default_rng([seed, 4])
    beams, span = int(rng.integers(180, 721)), math.pi * float(rng.choice([1.0, 1.5, 2.0]))
    lidar = LidarConfig(
        beams=beams, field_of_view_rad=span, rate_hz=float(rng.choice([5.0, 8.0, 10.0, 12.5, 20.0])),
        sigma_range_m=float(rng.uniform(0.01, 0.03)), x_m=float(rng.uniform(-0.1, 0.25)),
    )  # fmt: skip
    speed = float(rng.uniform(0.4, 0.9))
    robot = RobotConfig(v_max_m_s=speed, omega_max_rad_s=float(rng.uniform(0.7, 1.5)), acceleration_m_s2=speed)
    chance = float(rng.uniform(0.5, 1.5))
    noise = OdometryNoise(
        distance_scale=1.0, turn_scale=1.0, bias_rad_per_m=0.0,
        alpha1=2e-4 * chance, alpha2=1e-4 * chance, alpha3=2e-4 * chance, alpha4=1e-4 * chance,
    )  # fmt: skip
    log = simulate(make_world(_WORLDS[seed % len(_WORLDS)], rng), robot, noise, lidar, rng)
    metres = np.cumsum(np.hypot(*np.diff(log.truth.poses[:, :2], axis=0, prepend=log.truth.poses[:1, :2]).T))
    longest = float(rng.uniform(30, 200))
    pairs = takewhile(lambda pair: pair[0] < longest, zip(metres.tolist(), log.measurements, strict=True))
    return [measurement for _, measurement in pairs]


def told(measurements: Iterable[Measurement]) -> tuple[list[Finding], str, float]:
    """What is found, the estimates in one line, and the CPU seconds it took."""
    began = time.process_time()
    motion = laser_motion(measurements)
    found = calibrate(motion)
    findings = motion_findings(motion, found)
    seconds = time.process_time() - began
    estimates = [found.scale, found.turn_scale, found.drift_rad_per_m, found.yaw_rad, found.skew_s]
    line = " ".join(f"{e.value:+.4f}+-{e.sigma:.4f}{'' if e.determined else '?'}" for e in estimates)
    return findings, f"{len(motion)} scans, {found.laser_m:.0f} m, {found.laser_rad:.0f} rad: {line}", seconds


def doctor(
    report: Report, seeds: Sequence[int], faults: Sequence[str] = FAULTS_OF_MOTION, verbose: bool = False
) -> None:
    """Give each log each fault in turn, and none; add one table and its targets to the report."""
    logs = {seed: any_log(seed) for seed in seeds}
    rows = [_row(name, logs, report, verbose) for name in ("clean", *faults)]
    report.sections.append(f"## What the doctor finds by motion: {len(logs)} logs\n\n{table(_HEAD, rows)}")


def _row(name: str, logs: dict[int, list[Measurement]], report: Report, verbose: bool) -> list[object]:
    named, close, errors, others, spent = 0, 0, [], [], []
    for seed, log in logs.items():
        rng = np.random.default_rng(seed)
        findings, line, seconds = told(log if name == "clean" else with_fault(log, name, rng))
        spent.append(seconds)
        faults = {finding.code: finding for finding in findings if finding.is_fault}
        finding = faults.pop(name, None)
        others += list(faults)
        error = _error(name, finding)
        named += finding is not None
        close += error <= _CLOSE
        errors.append(error)
        if verbose:
            size = "" if finding is None else finding.size
            print(name, seed, size, sorted(faults), line, f"{seconds:.2f} s", flush=True)
    size = 0.0 if name == "clean" else FAULTS[name].size
    if name != "clean":
        missed = Target(f"{name}: logs in which it is not named in size", len(logs) - close, len(logs) // 20)
        report.targets.append(missed)
    report.targets.append(Target(f"{name}: other faults told", len(others), 0))
    known = [error for error in errors if math.isfinite(error)] or [math.nan]
    return [name, size, named, close, statistics.median(known), max(known), ", ".join(sorted(others)) or "none",
            statistics.median(spent), max(spent)]  # fmt: skip


def _error(name: str, finding: Finding | None) -> float:
    """Relative error of the size; 0 where only the name counts, infinite where the fault was not named."""
    if finding is None or finding.size is None:
        return math.inf
    if name == "reflected_laser":
        return 0.0
    true = FAULTS[name].size
    apart = math.remainder(finding.size - true, math.tau) if name == "yaw_offset" else finding.size - true
    return abs(apart / true)


def main() -> None:
    """Run it and print the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", nargs="*", default=list(FAULTS_OF_MOTION))
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    report = Report()
    doctor(report, range(options.seeds), options.only, options.verbose)
    print(*report.sections, report.summary(), sep="\n\n")


if __name__ == "__main__":
    main()
