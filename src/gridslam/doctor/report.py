"""A diagnosis as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from gridslam import __version__
from gridslam.doctor.diagnose import Diagnosis
from gridslam.doctor.finding import Finding, Severity, percent

SCHEMA = "gridslam.doctor/3"
_LEVEL_DEG = 0.5

_HEADS = {
    Severity.ERROR: "Faults that make the map unusable",
    Severity.WARNING: "Warnings",
    Severity.INFO: "For information",
}


def document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as JSON values; unknown or unlimited values are null."""
    statistics = diagnosis.statistics
    return {
        "schema": SCHEMA,
        "version": __version__,
        "log": {
            "path": str(diagnosis.path),
            "scans": diagnosis.scans,
            "duration_s": statistics.duration_s,
            "odometry_length_m": diagnosis.metres,
            "odometry_turns_rad": diagnosis.radians,
            "lasers": dict(diagnosis.lasers),
        },
        "worst": diagnosis.worst.value,
        "counts": {s.value: sum(f.severity is s for f in diagnosis.findings) for s in Severity},
        "findings": [_finding(finding) for finding in diagnosis.findings],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    size = finding.size
    finite = size if size is not None and math.isfinite(size) else None
    return {**asdict(finding), "severity": finding.severity.value, "size": finite}


def text(diagnosis: Diagnosis) -> list[str]:
    """Format a diagnosis as lines for a terminal."""
    lines = [
        f"{diagnosis.path.name}: {diagnosis.scans} scans in {diagnosis.statistics.duration_s:.0f} s, "
        f"{diagnosis.metres:.1f} m and {math.degrees(diagnosis.radians):.0f} degrees of odometry",
        *(f"  {line}" for line in _facts(diagnosis)),
    ]
    for severity, head in _HEADS.items():
        found = [finding for finding in diagnosis.findings if finding.severity is severity]
        if found:
            lines += ["", f"{head}:"]
        for finding in found:
            lines.append(f"  {finding.title}: {finding.message}")
            lines += [f"    -> {finding.remedy}"] if finding.remedy else []
    return [*lines, "", verdict(diagnosis)]


def verdict(diagnosis: Diagnosis) -> str:
    """Summarize the diagnosis in one sentence."""
    spoiling = sum(finding.severity is Severity.ERROR for finding in diagnosis.findings)
    doubtful = len(diagnosis.faults) - spoiling
    if spoiling:
        more = f"; {_count(doubtful, 'warning')}" if doubtful else ""
        return f"The map would be unusable: {_count(spoiling, 'fault')}{more}."
    if doubtful:
        return f"No fault makes the map unusable; {_count(doubtful, 'warning')}."
    return "This log is healthy: nothing was found that would harm the map."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _facts(diagnosis: Diagnosis) -> Iterator[str]:
    for sensor, facts in diagnosis.lasers.items():
        rate = "unknown rate" if facts["rate_hz"] is None else f"{facts['rate_hz']:.3g} scans/s"
        farthest = "inf" if facts["range_max_m"] is None else f"{facts['range_max_m']:g}"
        yield (
            f"{sensor}: {rate}, {facts['beams']} beams over {math.degrees(facts['field_of_view_rad']):.0f} degrees "
            f"{facts['direction']}, range {facts['range_min_m']:g} to {farthest} m; "
            f"{percent(facts['no_return_share'])} of the beams return nothing, "
            f"{percent(facts['invalid_share'])} are invalid"
        )
        at = facts["mounting"]
        level = "upside down" if at["upside_down"] else "upright"
        tilt_deg = math.degrees(at["tilt_rad"])
        tilt = f", tilted by {tilt_deg:.1f} degrees" if tilt_deg > _LEVEL_DEG else ""
        yaw_deg = math.degrees(at["yaw_rad"])
        yield f"  mounted at x {at['x_m']:.3f} m, y {at['y_m']:.3f} m, yaw {yaw_deg:.1f} degrees, {level}{tilt}"
