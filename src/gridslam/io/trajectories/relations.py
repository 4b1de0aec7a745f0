"""Relations files: ``t1 t2 x y z roll pitch yaw`` (s, m, rad), the true pose at t2 seen from the pose at t1."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.trajectory import Relations
from gridslam.geometry.angles import wrap
from gridslam.io.trajectories.table import read_table

__all__ = ["read_relations"]

_PLANAR = (1e-3, 1e-3, 1e-3)  # m, rad, rad


def read_relations(path: str | Path) -> Relations:
    """Read the planar relations of a file, in file order.

    Raises
    ------
    InputError
        Where the file cannot be read, holds no relation, or a line is not eight finite numbers of a planar motion
        (z, roll and pitch below 1e-3).

    Notes
    -----
    Source: Kuemmerle et al., *On measuring the accuracy of SLAM algorithms* (2009).
    """
    table = read_table(path, 2, "t1 t2 x y z roll pitch yaw")
    tilted = np.flatnonzero((np.abs(table.values[:, 2:5]) > _PLANAR).any(axis=1))
    if len(tilted):
        got = " ".join(f"{value:g}" for value in table.values[tilted[0], 2:5])
        raise InputError(path, f"expected a planar relation (z roll pitch 0), got {got}", table.lines[tilted[0]])
    poses = np.column_stack([table.values[:, :2], wrap(table.values[:, 5])])
    return Relations(table.stamps_ns[:, 0], table.stamps_ns[:, 1], poses)
