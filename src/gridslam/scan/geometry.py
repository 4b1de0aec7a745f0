"""Where the beams of a laser point, and where it sits on the robot."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import freeze
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.scan.arrays import FloatArray

__all__ = ["ScanGeometry"]


@final
class ScanGeometry:
    """Where the beams of a laser point, seen from the robot's base; one object is shared by all scans of a laser.

    Parameters
    ----------
    bearings : (B,) float64, rad
        Angle of each beam in the laser's frame, counter-clockwise.
    base_from_laser : (4, 4) float64, optional
        SE(3) mounting of the laser (homogeneous; m); identity if not given. A planar mounting comes from `planar`.

    Attributes
    ----------
    directions : (B, 2) float64
        Direction of each beam in the base frame, projected on the ground plane (shorter than 1 for a tilted laser).
    origin : (2,) float64, m
        The laser's place in the base frame.
    widths : (B,) float64, rad
        Angle between each beam and the one before it, the last before the first.
    """

    __slots__ = ("base_from_laser", "bearings", "directions", "origin", "widths")

    def __init__(self, bearings: ArrayLike, base_from_laser: ArrayLike | None = None) -> None:
        self.bearings: FloatArray = freeze(bearings, np.float64, (None,), "bearings")
        if not np.isfinite(self.bearings).all():
            raise ArgumentError("bearings", "finite angles in rad", "a value that is not finite")
        mounting = np.eye(4) if base_from_laser is None else base_from_laser
        self.base_from_laser: FloatArray = freeze(mounting, np.float64, (4, 4), "base_from_laser")
        if not np.isfinite(self.base_from_laser).all():
            raise ArgumentError("base_from_laser", "finite numbers", self.base_from_laser.tolist())
        rotation = self.base_from_laser[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise ArgumentError("base_from_laser", "a rotation in its upper left 3x3 block", rotation.tolist())
        in_laser = np.stack([np.cos(self.bearings), np.sin(self.bearings), np.zeros_like(self.bearings)])
        self.directions: FloatArray = freeze((rotation @ in_laser)[:2].T, np.float64, (None, 2), "directions")
        self.origin: FloatArray = freeze(self.base_from_laser[:2, 3], np.float64, (2,), "origin")
        gaps = np.abs(wrap(self.bearings - np.roll(self.bearings, 1)))
        self.widths: FloatArray = freeze(gaps, np.float64, (None,), "widths")

    def __repr__(self) -> str:
        """Return one line."""
        first, last = np.degrees(self.bearings[[0, -1]]) if len(self.bearings) else (math.nan, math.nan)
        x, y = self.origin.tolist()
        return f"ScanGeometry({len(self.bearings)} beams, {first:.1f} to {last:.1f} deg, at x {x:.3f} m, y {y:.3f} m)"

    @classmethod
    def planar(cls, bearings: ArrayLike, base_from_laser: ArrayLike) -> ScanGeometry:
        """Geometry of a laser mounted level at the planar pose `base_from_laser` (3,) = [x m, y m, theta rad]."""
        x, y, theta = freeze(base_from_laser, np.float64, (3,), "base_from_laser")
        c, s = np.cos(theta), np.sin(theta)
        return cls(bearings, [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
