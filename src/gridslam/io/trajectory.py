"""Trajectories in the TUM form: ``stamp x y z qx qy qz qw`` (s, m, unit quaternion), one pose a line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gridslam.errors import InputError
from gridslam.geometry.angles import wrap
from gridslam.io.table import read_table
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
    table = read_table(path, 1, "stamp x y z qx qy qz qw")
    x, y, _, qx, qy, qz, qw = table.values.T
    norm = np.sqrt(qx**2 + qy**2 + qz**2 + qw**2)
    bad = np.flatnonzero(abs(norm - 1) > 0.01)
    if len(bad):
        raise InputError(path, f"expected a unit quaternion, got one of norm {norm[bad[0]]:g}", table.lines[bad[0]])
    yaw = wrap(np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2))
    return Trajectory(table.stamps_ns[:, 0], np.column_stack([x, y, yaw]))
