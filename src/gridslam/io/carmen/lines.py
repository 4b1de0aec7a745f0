"""The forms of a scan's line in CARMEN logs: many lines of one form become arrays in one conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.angles import find_wrong_beam_angles
from gridslam.io.measurement import FARTHEST_M
from gridslam.types import FloatArray

SCAN_TAGS = {"FLASER": "front", "RLASER": "rear", "REMISSIONFLASER": "front", "ROBOTLASER1": "robotlaser1"}
"""Tags of lines that hold a scan, with the name of the sensor they are from."""

_POSE = f"expected a finite x y theta of less than {FARTHEST_M:g}"
_ROBOTLASER_TAIL = 11  # laser pose, robot pose, tv, rv, forward and side safety distance, turn axis


class LineError(ValueError):
    """A line does not have the form of its tag; `row` is the index of the line."""

    row = 0


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
    ranges : (K, B) float64, m
        As they stand in the log.
    laser_poses, robot_poses : (K, 3) float64 or None
        Poses in the line; None where this form has none.
    layout : BeamLayout or None
        None if the line does not state it.
    """

    ranges: FloatArray
    laser_poses: FloatArray | None
    robot_poses: FloatArray | None
    layout: BeamLayout | None = None


def parse_pose(words: Sequence[str]) -> FloatArray:
    """Return pose (3,) of three words; raises LineError where one is no number, or too large for a pose."""
    try:
        pose = np.array([float(word) for word in words])
    except ValueError:
        raise LineError(f"expected x y theta, got {' '.join(words)!r}") from None
    if pose.shape != (3,) or not (np.abs(pose) < FARTHEST_M).all():
        raise LineError(f"{_POSE}, got {' '.join(words)!r}")
    return pose


def parse_rows(tag: str, texts: Sequence[str]) -> list[tuple[int, ScanRows]]:
    """Convert the numbers between tag and stamp of lines of one tag: scans, and which line the first of them is on.

    Lines of the same length are converted by one call, which also proves that each has the same number of values.
    Raises LineError with the offending row.
    """
    try:
        values = np.loadtxt(texts, dtype=np.float64, comments=None, ndmin=2)
        if len(values) == len(texts) and _have_same_form(tag, values):
            return [(0, _decode(tag, values))]
    except ValueError:
        pass  # below it is found out which line it is
    found = []
    for row, text in enumerate(texts):
        try:
            found.append((row, _decode(tag, _numbers(tag, text))))
        except LineError as error:
            error.row = row
            raise
    return found


def _have_same_form(tag: str, values: FloatArray) -> bool:
    if tag != "ROBOTLASER1":
        return bool((values[:, 0] == values[0, 0]).all())
    settings = values[:, :8]
    remissions = values[:, min(8 + _count(tag, values, 7), values.shape[1] - 1)]
    return bool((settings == settings[0]).all() and (remissions == remissions[0]).all())


def _numbers(tag: str, text: str) -> FloatArray:
    """Return values (1, L) of one line."""
    numbers = []
    for place, word in enumerate(text.split(), 2):
        try:
            numbers.append(float(word))
        except ValueError:
            raise LineError(f"expected a number as word {place} of a {tag} line, got {word!r}") from None
    return np.array([numbers])


def _decode(tag: str, values: FloatArray) -> ScanRows:
    decode = {"ROBOTLASER1": _robotlaser, "REMISSIONFLASER": _remissions}.get(tag, _flaser)
    rows = decode(tag, values)
    for poses in (rows.laser_poses, rows.robot_poses):
        if poses is not None:
            bad = np.flatnonzero(~(np.abs(poses) < FARTHEST_M).all(axis=1))
            if len(bad):
                raise LineError(f"{_POSE}, got {' '.join(map(str, poses[bad[0]]))}")
    return rows


def _count(tag: str, values: FloatArray, column: int) -> int:
    """Read the number that stands in `column` as a count of values that follow."""
    count = values[0, column] if column < values.shape[1] else np.nan
    if not (0 <= count < 1e6 and count == int(count)):
        raise LineError(f"expected a whole number as word {column + 2} of a {tag} line, got {count:g}")
    return int(count)


def _beam_count(tag: str, values: FloatArray, column: int) -> int:
    n = _count(tag, values, column)
    if n == 0:
        raise LineError(f"expected at least one reading in a {tag} line, got 0")
    return n


def _check_length(tag: str, values: FloatArray, n: int, length: int) -> None:
    missing = length - values.shape[1]
    if missing:
        few = "too few" if missing > 0 else "too many"
        problem = f"expected {n} readings and what follows them in a {tag} line, got {abs(missing)} values {few}"
        raise LineError(problem)


def _flaser(tag: str, values: FloatArray) -> ScanRows:
    """``n r1..rn x y theta odom_x odom_y odom_theta``, or without the poses."""
    n = _beam_count(tag, values, 0)
    ranges = values[:, 1 : n + 1]
    if values.shape[1] == n + 1:
        return ScanRows(ranges, None, None)
    _check_length(tag, values, n, n + 7)
    return ScanRows(ranges, values[:, n + 1 : n + 4], values[:, n + 4 :])


def _remissions(tag: str, values: FloatArray) -> ScanRows:
    """``n r1 remission1..rn remission_n``: an old form without poses."""
    n = _beam_count(tag, values, 0)
    _check_length(tag, values, n, 2 * n + 1)
    return ScanRows(np.ascontiguousarray(values[:, 1::2]), None, None)


def _robotlaser(tag: str, values: FloatArray) -> ScanRows:
    """``type start fov step max accuracy mode n r1..rn m rem1..rem_m laser_pose robot_pose tv rv fwd side axis``."""
    n = _beam_count(tag, values, 7)
    if values.shape[1] < n + 9:
        _check_length(tag, values, n, n + 9 + _ROBOTLASER_TAIL)
    end = n + 9 + _count(tag, values, n + 8)
    _check_length(tag, values, n, end + _ROBOTLASER_TAIL)
    start, field_of_view, step, max_m = values[0, 1:5].tolist()
    if not step > 0:
        raise LineError(f"expected a positive angular resolution in rad, got {step:g}")
    if problem := find_wrong_beam_angles(start, step, n, start + field_of_view):
        raise LineError(problem)
    layout = BeamLayout(start, step, max_m)
    return ScanRows(values[:, 8 : n + 8], values[:, end : end + 3], values[:, end + 3 : end + 6], layout)
