"""Whether an odometry's path follows its own heading: one of wheels does, unless one of the two is mirrored."""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.types import FloatArray

Mirrored: TypeAlias = Literal["", "heading", "path"]
"""Component of the odometry with the wrong sign: none, the heading, or the y of the position."""

_SIGNS: Final = {"": (1.0, 1.0, 1.0), "heading": (1.0, 1.0, -1.0), "path": (1.0, -1.0, 1.0)}
_STEP_M = 0.1  # of the path: directions of shorter steps are noise
_FEWEST_STEPS = 20
_FOLLOWS = 0.9  # agreement of directions and headings; wheels slip sideways by some hundredths of the way
_UNLIKE = 0.6


def contradicts_its_heading(odometry: FloatArray) -> bool:
    """Return whether a path leads where the headings would if they had the other sign, and not where they point.

    A robot with wheels mostly drives where it points, up to a constant, for the base may be turned. A straight path
    fits both signs, and that of a robot which drives sideways, or as often backward, neither: they decide nothing.

    Parameters
    ----------
    odometry : (K, 3) float64
        Poses, m and rad; those that are not finite are left out.
    """
    poses = odometry[np.isfinite(odometry).all(axis=1)]
    if not len(poses):
        return False
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    poses = poses[np.unique(np.floor(way / _STEP_M), return_index=True)[1]]
    if len(poses) <= _FEWEST_STEPS:
        return False
    steps = np.diff(poses, axis=0)
    directions = np.arctan2(steps[:, 1], steps[:, 0])
    headings = poses[:-1, 2] + 0.5 * wrap(steps[:, 2])
    follows, mirrored = (abs(np.exp(1j * (directions - sign * headings)).mean()) for sign in (1, -1))
    return bool(mirrored > _FOLLOWS and follows < _UNLIKE)


def unmirror_odometry(poses: FloatArray, mirrored: Mirrored) -> FloatArray:
    """Return poses (..., 3) with the sign that they should have."""
    changed = poses * _SIGNS[mirrored]
    changed[..., 2] = np.where(changed[..., 2] == math.pi, -math.pi, changed[..., 2])
    return changed
