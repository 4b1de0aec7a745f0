"""Trajectories in the TUM form: ``stamp x y z qx qy qz qw`` (s, m, unit quaternion), one pose a line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gridslam.errors import InputError
from gridslam.io.carmen_lines import LineError, parse_stamp_ns
from gridslam.io.text_source import read_text
from gridslam.types import Trajectory

__all__ = ["read_tum", "write_tum"]


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory, in its own order; stamps are exact to the nanosecond, poses have nine decimals.

    Parameters
    ----------
    path : str or Path
        The file to write.
    trajectory : Trajectory
        Stamps in ns and planar poses in the map frame.
    """
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        for stamp, (x, y, theta) in zip(trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True):
            sign, (seconds, nanoseconds) = "-" if stamp < 0 else "", divmod(abs(stamp), 10**9)
            qz, qw = math.sin(theta / 2), math.cos(theta / 2)
            file.write(f"{sign}{seconds}.{nanoseconds:09d} {x:.9f} {y:.9f} 0 0 0 {qz:.9f} {qw:.9f}\n")


def read_tum(path: str | Path) -> Trajectory:
    """Read a trajectory, in file order; the heading is the yaw of the quaternion.

    Raises
    ------
    InputError
        Where the file cannot be read, holds no pose, or a line is not eight finite numbers with a quaternion of unit
        norm (within 1 %).
    """
    stamps, rows = [], []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 8:
            raise InputError(path, f"expected stamp x y z qx qy qz qw, got {len(words)} words", number)
        try:
            stamps.append(parse_stamp_ns(words[0]))
            row = [float(word) for word in words[1:]]
        except LineError as error:
            raise InputError(path, str(error), number) from None
        except ValueError:
            raise InputError(path, f"expected numbers, got {line!r}", number) from None
        norm = math.hypot(*row[3:])
        if not all(map(math.isfinite, row)) or abs(norm - 1) > 0.01:
            raise InputError(path, f"expected finite values and a unit quaternion, got {line!r}", number)
        rows.append(row)
    if not rows:
        raise InputError(path, "expected at least one pose, got none")
    x, y, _, qx, qy, qz, qw = np.array(rows).T
    yaw = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    yaw[yaw >= np.pi] -= 2 * np.pi
    return Trajectory(np.array(stamps, dtype=np.int64), np.column_stack([x, y, yaw]))
