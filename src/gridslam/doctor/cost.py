"""What mapping a log will cost."""

from __future__ import annotations

import math

from gridslam.doctor.finding import Finding, Severity

__all__ = ["estimate_cost"]

_START_S, _SCAN_S, _KEY_SCAN_S, _PARTICLE_S = 1.3, 3e-4, 1.5e-3, 1.8e-4
"""CPU time to begin and to write, of a scan read and tracked, of a key scan by itself and for each particle.

Measured on the Intel, ACES and CSAIL logs (30 particles; 13.2, 9.4 and 8.1 s where this predicts 17, 9.3 and 7.6 s)."""
_START_BYTES, _KEY_SCAN_BYTES = 170e6, 2.2e4
"""Memory of the program and of loop closure, and for each key scan.

Measured: 207, 198 and 212 MB on those logs (this predicts 208, 188 and 188), 738 MB with 25,000 key scans (720)."""
_PARTICLES = 30
_MUCH_BYTES = 2e9  # more than a small computer on a robot may have to spare


def estimate_cost(scans: int, key_scans: int) -> Finding:
    """Predict the time and memory of `gridslam map` with 30 particles from the number of scans and of key scans."""
    seconds = _START_S + scans * _SCAN_S + key_scans * (_KEY_SCAN_S + _PARTICLES * _PARTICLE_S)
    memory = _START_BYTES + key_scans * _KEY_SCAN_BYTES
    remedy = "If that is too much, map with --no-loop-closure or fewer --particles." if memory > _MUCH_BYTES else ""
    return Finding(
        "expected_cost", Severity.INFO,
        f"Mapping takes about {_rounded(seconds)} s and {_rounded(memory / 1e6)} MB: {scans} scans, some "
        f"{_rounded(key_scans)} key scans.",
        seconds, "s", remedy,
    )  # fmt: skip


def _rounded(number: float) -> str:
    """Two digits, the accuracy of the prediction."""
    if number <= 0:
        return "0"
    digits = 1 - math.floor(math.log10(number))
    return f"{round(number, digits):.{max(digits, 0)}f}"
