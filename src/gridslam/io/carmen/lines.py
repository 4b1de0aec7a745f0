"""The forms of a scan's line in CARMEN logs: many lines of one form become arrays in one conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.measurement import FARTHEST_M
from gridslam.types import FloatArray

__all__ = [
    "SCAN_TAGS", "BeamLayout", "LineError", "ScanRows", "format_stamp_ns", "parse_pose", "parse_rows", "parse_stamp_ns",
]  # fmt: skip

SCAN_TAGS = {"FLASER": "front", "RLASER": "rear", "REMISSIONFLASER": "front", "ROBOTLASER1": "robotlaser1"}
"""Tags of lines that hold a scan, with the name of the sensor they are from."""

_POSE = f"expected a finite x y theta of less than {FARTHEST_M:g}"
_ROBOTLASER_TAIL = 11  # laser pose, robot pose, tv, rv, forward and side safety distance, turn axis


class LineError(ValueError):
    """A line does not have the form of its tag; `row` is the index of the line."""

    def __init__(self, problem: str, row: int = 0) -> None:
        """State what was expected and what was found."""
        super().__init__(problem)
        self.row = row


@final
@dataclass(frozen=True, slots=True)
class BeamLayout:
    """Beam layout stated by a line (rad, m)."""

    start_rad: float
    step_rad: float
    max_m: float


@final
@dataclass(frozen=True, slots=True, eq=False)
class ScanRows:
    """Scans of one form.

    Attributes
    ----------
    first : int
        Which of the given lines the first row is.
    ranges : (K, B) float64, m
        As they stand in the log.
    laser_poses, robot_poses : (K, 3) float64 or None
        Poses in the line; None where this form has none.
    layout : BeamLayout or None
        None if the line does not state it.
    """

    first: int
    ranges: FloatArray
    laser_poses: FloatArray | None
    robot_poses: FloatArray | None
    layout: BeamLayout | None = None


def parse_stamp_ns(text: str) -> int:
    """Nanoseconds of a decimal number of seconds, exactly; raises LineError."""
    seconds, _, fraction = text.partition(".")
    if seconds.isdecimal() and fraction.isdecimal() and len(seconds) <= 10:
        stamp = int(seconds) * 10**9 + int(fraction[:9].ljust(9, "0"))
        if stamp < 2**63:
            return stamp
    try:
        value = Decimal(text).scaleb(9)
        if -(2**63) <= value < 2**63:
            return int(value)
    except ArithmeticError:
        pass
    raise LineError(f"expected a stamp in seconds that fits 64 bits of nanoseconds, got {text!r}")


def format_stamp_ns(stamp_ns: int) -> str:
    """Exact decimal seconds: six decimals, as is usual, or nine where needed."""
    sign, (seconds, nanoseconds) = "-" if stamp_ns < 0 else "", divmod(abs(stamp_ns), 10**9)
    fraction = f"{nanoseconds:09d}" if nanoseconds % 1000 else f"{nanoseconds // 1000:06d}"
    return f"{sign}{seconds}.{fraction}"


def parse_pose(words: Sequence[str]) -> FloatArray:
    """Pose (3,) of three words; raises LineError where one is no number, or too large for a pose."""
    try:
        pose = np.array([float(word) for word in words])
    except ValueError:
        raise LineError(f"expected x y theta, got {' '.join(words)!r}") from None
    if pose.shape != (3,) or not _are_poses(pose[None])[0]:
        raise LineError(f"{_POSE}, got {' '.join(words)!r}")
    return pose


def parse_rows(tag: str, texts: Sequence[str]) -> list[ScanRows]:
    """Convert the numbers between tag and stamp of lines of one tag; raises LineError with the offending row.

    Lines of the same length are converted by one call, which also proves that each has the same number of values.
    """
    try:
        values = np.loadtxt(texts, dtype=np.float64, comments=None, ndmin=2)
        same = len(values) == len(texts) and _same_form(tag, values)
    except ValueError:
        same = False
    if same:
        return [_decode(tag, values, 0)]
    return [_decode(tag, _numbers(tag, text, row), row) for row, text in enumerate(texts)]


def _same_form(tag: str, values: FloatArray) -> bool:
    if tag != "ROBOTLASER1":
        return bool((values[:, 0] == values[0, 0]).all())
    count = _count(tag, values, 7, 0)
    settings = values[:, :8]
    remissions = values[:, min(8 + count, values.shape[1] - 1)]
    return bool((settings == settings[0]).all() and (remissions == remissions[0]).all())


def _numbers(tag: str, text: str, row: int) -> FloatArray:
    """Values (1, L) of one line."""
    words = text.split()
    for place, word in enumerate(words, 2):
        try:
            float(word)
        except ValueError:
            raise LineError(f"expected a number as word {place} of a {tag} line, got {word!r}", row) from None
    return np.array([[float(word) for word in words]])


def _decode(tag: str, values: FloatArray, row: int) -> ScanRows:
    decode = {"ROBOTLASER1": _robotlaser, "REMISSIONFLASER": _remissions}.get(tag, _flaser)
    rows = decode(tag, values, row)
    for poses in (rows.laser_poses, rows.robot_poses):
        if poses is not None and not (usable := _are_poses(poses)).all():
            bad = int(np.flatnonzero(~usable)[0])
            raise LineError(f"{_POSE}, got {' '.join(map(str, poses[bad]))}", row + bad)
    return rows


def _are_poses(poses: FloatArray) -> NDArray[np.bool_]:
    """Whether each of (N, 3) is finite and of a robot on Earth."""
    return np.asarray((np.abs(poses) < FARTHEST_M).all(axis=1))


def _count(tag: str, values: FloatArray, column: int, row: int) -> int:
    """Read the number that stands in `column` as a count of values that follow."""
    count = values[0, column] if column < values.shape[1] else np.nan
    if not (0 <= count < 1e6 and count == int(count)):
        raise LineError(f"expected a whole number as word {column + 2} of a {tag} line, got {count:g}", row)
    return int(count)


def _check_length(tag: str, n: int, missing: int, row: int) -> None:
    if missing:
        few = "too few" if missing > 0 else "too many"
        problem = f"expected {n} readings and what follows them in a {tag} line, got {abs(missing)} values {few}"
        raise LineError(problem, row)


def _beam_count(tag: str, values: FloatArray, column: int, row: int) -> int:
    n = _count(tag, values, column, row)
    if n == 0:
        raise LineError(f"expected at least one reading in a {tag} line, got 0", row)
    return n


def _flaser(tag: str, values: FloatArray, row: int) -> ScanRows:
    """``n r1..rn x y theta odom_x odom_y odom_theta``, or without the poses."""
    n = _beam_count(tag, values, 0, row)
    ranges, tail = values[:, 1 : n + 1], values[:, n + 1 :]
    if values.shape[1] == n + 1:
        return ScanRows(row, ranges, None, None)
    _check_length(tag, n, n + 7 - values.shape[1], row)
    return ScanRows(row, ranges, tail[:, :3], tail[:, 3:])


def _remissions(tag: str, values: FloatArray, row: int) -> ScanRows:
    """``n r1 remission1..rn remission_n``: an old form without poses."""
    n = _beam_count(tag, values, 0, row)
    _check_length(tag, n, 2 * n + 1 - values.shape[1], row)
    return ScanRows(row, np.ascontiguousarray(values[:, 1::2]), None, None)


def _robotlaser(tag: str, values: FloatArray, row: int) -> ScanRows:
    """``type start fov step max accuracy mode n r1..rn m rem1..rem_m laser_pose robot_pose tv rv fwd side axis``."""
    n = _beam_count(tag, values, 7, row)
    if values.shape[1] < n + 9:
        _check_length(tag, n, n + 9 + _ROBOTLASER_TAIL - values.shape[1], row)
    end = n + 9 + _count(tag, values, n + 8, row)
    _check_length(tag, n, end + _ROBOTLASER_TAIL - values.shape[1], row)
    start, step, max_m = (float(values[0, column]) for column in (1, 3, 4))
    if not (np.isfinite([start, step]).all() and step > 0):
        raise LineError(f"expected a start angle and a positive angular resolution, got {start:g} and {step:g}", row)
    ranges, poses = values[:, 8 : n + 8], values[:, end : end + 6]
    return ScanRows(row, ranges, poses[:, :3], poses[:, 3:], BeamLayout(start, step, max_m))
