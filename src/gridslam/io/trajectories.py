"""Trajectories as text: TUM and EuRoC, and CSV with the covariance of each pose; relations between poses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap_headings
from gridslam.io.measurement import FARTHEST_M
from gridslam.io.tables import (
    Table,
    check_rows,
    parse_stamp_ns,
    parse_whole_ns,
    read_table,
    symmetric_of_upper,
    upper_of_symmetric,
)
from gridslam.io.text import read_numbered_lines
from gridslam.types import FloatArray, IntArray, Trajectory

if TYPE_CHECKING:
    from gridslam.evaluation.trajectory import Relations

CSV_HEADER = (
    "stamp_s,x_m,y_m,theta_rad,cov_xx_m2,cov_xy_m2,cov_xtheta_m_rad,cov_yy_m2,cov_ytheta_m_rad,cov_thetatheta_rad2"
)
"""First line of a trajectory in CSV: the columns with their units."""

_TUM_ROW = "%s%d.%09d" + " %.9f" * 2 + " %.9g" * 3 + " %.9f" * 2 + "\n"
_CSV_ROW = "%s%d.%09d" + ",%.9f" * 3 + ",%.9g" * 6 + "\n"
"""Sign, seconds and nanoseconds of the stamp, poses of nine decimals; covariances have nine significant digits."""
_PLANAR = (1e-3, 1e-3, 1e-3)  # m, rad, rad
_DIGITS_OF_NS = 17  # since 1973; in s it would be a time of a billion years
_TIME_NAMES = ("timestamp", "time", "stamp", "t")  # of the first column, in a line of names


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory, in its own order, as ``stamp x y z qx qy qz qw`` (s, m, unit quaternion), one pose a line.

    Stamps are exact to the nanosecond, poses have nine decimals.

    Parameters
    ----------
    path : str or Path
        The file to write.
    trajectory : Trajectory
        Stamps in ns and planar poses in the map frame.
    """
    half = [angle / 2 for angle in trajectory.poses[:, 2].tolist()]
    values = np.zeros((len(half), 7))
    values[:, :2] = trajectory.poses[:, :2]
    values[:, 5] = list(map(math.sin, half))
    values[:, 6] = list(map(math.cos, half))
    Path(path).write_bytes(_format_rows(_TUM_ROW, trajectory.stamps_ns, values))


def _format_rows(form: str, stamps_ns: IntArray, values: FloatArray) -> bytes:
    """Return a line for each row, of its stamp in s, exact to the nanosecond, and its values (N, K)."""
    rows = zip(stamps_ns.tolist(), values.tolist(), strict=True)
    lines = (form % ("-" if stamp < 0 else "", *divmod(abs(stamp), 10**9), *row) for stamp, row in rows)
    return "".join(lines).encode()


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory in the form that its first row has, in file order.

    - TUM: as `read_tum`.
    - EuRoC: commas, a stamp in ns, position, quaternion with w first; further columns are left out.

    Raises
    ------
    InputError
        As `read_tum`.
    """
    first = _first_row(path)
    words = _split(first)
    if "," in first and len(words) >= 8 and _is_ns(words[0]):
        how = {"parse_stamp": parse_whole_ns, "split": lambda line: line.split(",")[:8], "skip": _has_names}
        table = read_table(path, "timestamp x y z qw qx qy qz", 1, **how)
        return _of_quaternions(path, table._replace(values=table.values[:, [0, 1, 2, 4, 5, 6, 3]]))
    return read_tum(path)


def _is_ns(stamp: str) -> bool:
    """Return whether a stamp is one in ns."""
    return stamp.isdecimal() and len(stamp) >= _DIGITS_OF_NS


def read_tum(path: str | Path) -> Trajectory:
    """Read a trajectory, in file order; the heading is the yaw of the quaternion.

    Values are separated by blanks, or by commas; a line may have the columns' names. Stamps are in s, or in ns since
    1970 where the first one is a whole number of 17 digits or more.

    Raises
    ------
    InputError
        Where the file cannot be read, holds no pose, or a line is not eight finite numbers with a position within 1e9 m
        and a quaternion of unit norm (within 1 %).
    """
    first = _split(_first_row(path))
    parse = parse_whole_ns if first and _is_ns(first[0]) else parse_stamp_ns
    how = {"parse_stamp": parse, "split": _split, "skip": _has_names}
    return _of_quaternions(path, read_table(path, "stamp x y z qx qy qz qw", 1, **how))


def _first_row(path: str | Path) -> str:
    """Return the first line of numbers; empty where there is none."""
    return next((line for _, line in read_numbered_lines(path) if not _has_names(line)), "")


def _has_names(line: str) -> bool:
    """Return whether a line has the names of the columns."""
    return (_split(line) or [""])[0].lower() in _TIME_NAMES


def _split(line: str) -> list[str]:
    """Words of a line, separated by blanks or commas."""
    return line.replace(",", " ").split()


def _of_quaternions(path: str | Path, table: Table) -> Trajectory:
    """Planar poses of rows x y z qx qy qz qw."""
    x, y, _, qx, qy, qz, qw = table.values.T
    norm = np.sqrt(qx**2 + qy**2 + qz**2 + qw**2)
    unit = abs(norm - 1) <= 0.01
    check_rows(path, table.lines, unit, lambda row: f"expected a unit quaternion, got one of norm {norm[row]:g}")
    _check_positions(path, table)
    yaw = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    return Trajectory(table.stamps_ns[:, 0], wrap_headings(np.column_stack([x, y, yaw])))


def write_trajectory_csv(path: str | Path, trajectory: Trajectory, covariances: FloatArray) -> None:
    """Write a trajectory, in its own order, with the data of each pose; the first line is `CSV_HEADER`.

    Stamps are exact to the nanosecond, poses have nine decimals, covariances nine significant digits.

    Parameters
    ----------
    path : str or Path
        The file to write.
    trajectory : Trajectory
        Stamps in ns and N planar poses in the map frame.
    covariances : (N, 3, 3) float64
        By x, y in m and theta in rad; the upper triangle is written.

    Raises
    ------
    ArgumentError
        There is not one covariance for each pose.
    """
    if covariances.shape != (len(trajectory), 3, 3):
        raise ArgumentError("covariances", f"shape ({len(trajectory)}, 3, 3)", covariances.shape)
    values = np.concatenate([trajectory.poses, upper_of_symmetric(covariances)], axis=1)
    Path(path).write_bytes(f"{CSV_HEADER}\n".encode() + _format_rows(_CSV_ROW, trajectory.stamps_ns, values))


def read_trajectory_csv(path: str | Path) -> tuple[Trajectory, FloatArray]:
    """Read a trajectory and its covariances (N, 3, 3), in file order.

    Raises
    ------
    InputError
        Where the file cannot be read, its first line is not `CSV_HEADER`, it holds no pose, or a line is not ten finite
        numbers with a position within 1e9 m.
    """
    table = read_table(path, CSV_HEADER, stamps=1)
    _check_positions(path, table)
    poses = wrap_headings(table.values[:, :3])  # nine decimals may round beyond pi
    return Trajectory(table.stamps_ns[:, 0], poses), symmetric_of_upper(table.values[:, 3:])


def _check_positions(path: str | Path, table: Table) -> None:
    """Refuse a pose farther than any robot can be; its x and y are the first two values."""
    positions = table.values[:, :2]
    expected = f"expected a position within {FARTHEST_M:g} m"
    near = (np.abs(positions) <= FARTHEST_M).all(axis=1)
    check_rows(path, table.lines, near, lambda row: f"{expected}, got {positions[row, 0]:g} {positions[row, 1]:g}")


def read_relations(path: str | Path) -> Relations:
    """Read relations, ``t1 t2 x y z roll pitch yaw`` (s, m, rad): the true pose at t2 seen from the pose at t1.

    Raises
    ------
    InputError
        Where the file cannot be read, holds no relation, or a line is not eight finite numbers of a planar motion
        (z, roll and pitch below 1e-3).

    Notes
    -----

    References
    ----------
    Kuemmerle et al., *On measuring the accuracy of SLAM algorithms* (2009).
    """
    from gridslam.evaluation.trajectory import Relations  # only the evaluation pays for its import

    stamps_ns, values, lines = read_table(path, "t1 t2 x y z roll pitch yaw", stamps=2)
    tilt = values[:, 2:5]

    def describe(row: int) -> str:
        return f"expected a planar relation (z roll pitch 0), got {' '.join(f'{value:g}' for value in tilt[row])}"

    check_rows(path, lines, (np.abs(tilt) <= _PLANAR).all(axis=1), describe)
    return Relations(stamps_ns[:, 0], stamps_ns[:, 1], wrap_headings(values[:, [0, 1, 5]]))
