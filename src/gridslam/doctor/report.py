"""A diagnosis as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from gridslam import __version__
from gridslam.doctor.diagnose import Diagnosis, LaserFacts
from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.io.remote import find_origin

SCHEMA = "gridslam.doctor/3"

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
            "path": find_origin(diagnosis.path) or str(diagnosis.path),
            "scans": sum(facts.scans for facts in diagnosis.lasers.values()),
            "duration_s": statistics.duration_s,
            "odometry_length_m": diagnosis.metres,
            "odometry_turns_rad": diagnosis.radians,
            "lasers": {sensor: _laser(facts) for sensor, facts in diagnosis.lasers.items()},
        },
        "worst": diagnosis.worst.value,
        "counts": {s.value: sum(f.severity is s for f in diagnosis.findings) for s in Severity},
        "findings": [_finding(finding) for finding in diagnosis.findings],
    }


def _laser(facts: LaserFacts) -> dict[str, Any]:
    x, y, yaw = facts.mounting.tolist()
    return {
        "scans": facts.scans,
        "rate_hz": facts.rate_hz,
        "beams": facts.beams,
        "field_of_view_rad": facts.field_of_view_rad,
        "direction": "clockwise" if facts.clockwise else "counter-clockwise",
        "range_min_m": facts.range_min_m,
        "range_max_m": facts.range_max_m if math.isfinite(facts.range_max_m) else None,
        "invalid_share": facts.invalid_share,
        "no_return_share": facts.no_return_share,
        "mounting": {"x_m": x, "y_m": y, "yaw_rad": yaw, "tilt_rad": facts.tilt_rad, "upside_down": facts.upside_down},
    }


def _finding(finding: Finding) -> dict[str, Any]:
    size = finding.size
    return {
        "code": finding.code,
        "severity": finding.severity.value,
        "size": size if size is not None and math.isfinite(size) else None,
        "unit": finding.unit,
        "message": finding.message,
        "remedy": finding.remedy,
        "sensor": finding.sensor,
    }


def text(diagnosis: Diagnosis) -> list[str]:
    """Format a diagnosis as lines for a terminal."""
    lines = [_head(diagnosis), *(f"  {line}" for line in _facts(diagnosis))]
    for severity, head in _HEADS.items():
        found = [finding for finding in diagnosis.findings if finding.severity is severity]
        if found:
            lines += ["", f"{head}:"]
        for finding in found:
            lines.append(f"  {_title(finding)}: {finding.message}")
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


def _head(diagnosis: Diagnosis) -> str:
    scans = sum(facts.scans for facts in diagnosis.lasers.values())
    turns = math.degrees(diagnosis.radians)
    return (
        f"{diagnosis.path.name}: {scans} scans in {diagnosis.statistics.duration_s:.0f} s, {diagnosis.metres:.1f} m "
        f"and {turns:.0f} degrees of odometry"
    )


def _facts(diagnosis: Diagnosis) -> Iterator[str]:
    for sensor, facts in diagnosis.lasers.items():
        x, y, yaw = facts.mounting.tolist()
        rate = "unknown rate" if facts.rate_hz is None else f"{facts.rate_hz:.3g} scans/s"
        turns = "clockwise" if facts.clockwise else "counter-clockwise"
        yield (
            f"{sensor}: {rate}, {facts.beams} beams over {math.degrees(facts.field_of_view_rad):.0f} degrees {turns}, "
            f"range {facts.range_min_m:g} to {facts.range_max_m:g} m; {percent(facts.no_return_share)} of the beams "
            f"return nothing, {percent(facts.invalid_share)} are invalid"
        )
        level = "upside down" if facts.upside_down else "upright"
        tilt = f", tilted by {math.degrees(facts.tilt_rad):.1f} degrees" if facts.tilt_rad > math.radians(0.5) else ""
        yield f"  mounted at x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(yaw):.1f} degrees, {level}{tilt}"


def _title(finding: Finding) -> str:
    return f"{finding.code} ({finding.sensor})" if finding.sensor else finding.code
