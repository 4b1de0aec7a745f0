"""Trajectories as text: TUM (stamp and pose), and CSV with the covariance of each pose."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import wrap
from gridslam.io.carmen.lines import LineError, parse_stamp_ns
from gridslam.io.text import read_text
from gridslam.io.trajectories.table import read_table
from gridslam.types import FloatArray, Trajectory

__all__ = [
    "CSV_HEADER", "columns_of_trajectory", "read_trajectory_csv", "read_tum", "write_trajectory_csv", "write_tum",
]  # fmt: skip

CSV_HEADER = (
    "stamp_s,x_m,y_m,theta_rad,cov_xx_m2,cov_xy_m2,cov_xtheta_m_rad,cov_yy_m2,cov_ytheta_m_rad,cov_thetatheta_rad2"
)
"""First line of a trajectory in CSV: the columns with their units."""

_UPPER = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]  # rows and columns of a covariance's six columns
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # which of those six each of the nine entries is


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
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        for stamp, (x, y, theta) in zip(trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True):
            qz, qw = math.sin(theta / 2), math.cos(theta / 2)
            file.write(f"{_seconds(stamp)} {x:.9f} {y:.9f} 0 0 0 {qz:.9f} {qw:.9f}\n")


def read_tum(path: str | Path) -> Trajectory:
    """Read a trajectory, in file order; the heading is the yaw of the quaternion.

    Raises
    ------
    InputError
        Where the file cannot be read, holds no pose, or a line is not eight finite numbers with a quaternion of unit
        norm (within 1 %).
    """
    table = read_table(path, 1, "stamp x y z qx qy qz qw")
    x, y, _, qx, qy, qz, qw = table.values.T
    norm = np.sqrt(qx**2 + qy**2 + qz**2 + qw**2)
    bad = np.flatnonzero(abs(norm - 1) > 0.01)
    if len(bad):
        raise InputError(path, f"expected a unit quaternion, got one of norm {norm[bad[0]]:g}", table.lines[bad[0]])
    yaw = wrap(np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2))
    return Trajectory(table.stamps_ns[:, 0], np.column_stack([x, y, yaw]))


def write_trajectory_csv(path: str | Path, trajectory: Trajectory, covariances: FloatArray) -> None:
    """Write a trajectory, in its own order, and what is known of each pose; the first line is `CSV_HEADER`.

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
    rows = np.concatenate([trajectory.poses, covariances[:, _UPPER[0], _UPPER[1]]], axis=1).tolist()
    form = ",%.9f,%.9f,%.9f,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n"
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        file.write(CSV_HEADER + "\n")
        for stamp, row in zip(trajectory.stamps_ns.tolist(), rows, strict=True):
            file.write(_seconds(stamp) + form % tuple(row))


def columns_of_trajectory(poses: FloatArray, covariances: FloatArray | None = None) -> dict[str, FloatArray]:
    """Columns (N,) of poses (N, 3), and of their covariances (N, 3, 3) where given, by `CSV_HEADER`'s names."""
    parts = [poses] if covariances is None else [poses, covariances[:, _UPPER[0], _UPPER[1]]]
    return dict(zip(CSV_HEADER.split(",")[1:], np.concatenate(parts, axis=1).T, strict=False))


def read_trajectory_csv(path: str | Path) -> tuple[Trajectory, FloatArray]:
    """Read a trajectory and its covariances (N, 3, 3), in file order.

    Raises
    ------
    InputError
        Where the file cannot be read, its first line is not `CSV_HEADER`, it holds no pose, or a line is not ten finite
        numbers.
    """
    header, *lines = read_text(path).splitlines()
    if header != CSV_HEADER:
        raise InputError(path, f"expected the columns {CSV_HEADER}, got {header!r}", 1)
    stamps, rows = list[int](), list[list[float]]()
    for number, line in enumerate(lines, 2):
        words = line.split(",")
        try:
            stamps.append(parse_stamp_ns(words[0]))
            rows.append([float(word) for word in words[1:]])
        except LineError as error:
            raise InputError(path, str(error), number) from None
        except ValueError:
            raise InputError(path, f"expected numbers ({CSV_HEADER}), got {line!r}", number) from None
        if len(rows[-1]) != 9 or not all(map(math.isfinite, rows[-1])):
            raise InputError(path, f"expected ten finite numbers ({CSV_HEADER}), got {line!r}", number)
    if not rows:
        raise InputError(path, f"expected rows of {CSV_HEADER}, got none")
    values = np.array(rows)
    poses = np.column_stack([values[:, :2], wrap(values[:, 2])])  # nine decimals may round beyond pi
    return Trajectory(np.array(stamps, np.int64), poses), values[:, 3:][:, _FULL].reshape(-1, 3, 3)


def _seconds(stamp_ns: int) -> str:
    """A stamp in seconds, exactly."""
    seconds, nanoseconds = divmod(abs(stamp_ns), 10**9)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"
