"""The lasers of a CARMEN log: where their beams point, how far they see and where they sit on the robot."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import final

import numpy as np

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.geometry.angles import wrap
from gridslam.io.carmen.lines import BeamLayout, LineError, ScanRows, parse_pose
from gridslam.io.log_statistics import Mounting
from gridslam.io.measurement import FARTHEST_LASER_M
from gridslam.io.text import TextSource
from gridslam.types import FloatArray, ScanGeometry

SICK_NO_RETURN_M = 81.83
"""Readings from here on are status codes of the SICK LMS (8183 to 8191 cm: overflow, dazzled, ...), never ranges."""

_SAME_PLACE = (1e-2, 1e-2, 1e-2)  # m, m, rad: how constant an offset must be to be a mounting
_FARTHEST_M = 1.0  # a laser farther from the robot's centre is not plausible on these robots
_ENOUGH_MOTION = (1.0, 0.5)  # m and rad driven: distinguishes a mounting from a correction of the pose
_MOST_SCANS = 2000
LASER_PARAMETERS = {
    "front": {
        "x": "robot_frontlaser_offset",
        "y": "robot_frontlaser_side_offset",
        "theta": "robot_frontlaser_angular_offset",
        "max": "robot_front_laser_max",
        "fov": "laser_front_laser_fov",
        "step": "laser_front_laser_resolution",
    },
    "rear": {
        "x": "robot_rearlaser_offset",
        "y": "robot_rearlaser_side_offset",
        "theta": "robot_rearlaser_angular_offset",
        "max": "robot_rear_laser_max",
        "fov": "laser_rear_laser_fov",
        "step": "laser_rear_laser_resolution",
    },
}
USED_PARAMETERS = frozenset(name for names in LASER_PARAMETERS.values() for name in names.values())
"""Parameters that describe a laser."""


@final
class CarmenLasers:
    """Decides each sensor's mounting once and shares one geometry between all its scans of the same beams."""

    def __init__(self, path: Path) -> None:
        """Start with nothing known of the lasers of the log at `path`."""
        self.mountings: dict[str, Mounting] = {}
        self._path = path
        self._parameters: dict[str, tuple[str, int]] = {}
        self._geometries: dict[tuple[str, int, BeamLayout | None], ScanGeometry] = {}

    def set_parameter(self, name: str, value: str, line: int) -> None:
        """Take one of `USED_PARAMETERS` for the scans that follow it."""
        if self._parameters.get(name, (None, 0))[0] == value:
            return
        self._parameters[name] = (value, line)
        self._geometries.clear()
        self.mountings = {sensor: known for sensor, known in self.mountings.items() if known.source == "line"}

    def geometry(self, tag: str, sensor: str, rows: ScanRows) -> ScanGeometry:
        """Return the geometry that the scans `rows` of a sensor share."""
        key = (sensor, rows.ranges.shape[1], rows.layout)
        if key not in self._geometries:
            if sensor not in self.mountings:
                self.mountings[sensor] = self._mounting(tag, sensor, rows)
            bearings = self._bearings(sensor, rows.ranges.shape[1], rows.layout)
            self._geometries[key] = ScanGeometry.planar(bearings, self.mountings[sensor].pose)
        return self._geometries[key]

    def range_max_m(self, sensor: str, layout: BeamLayout | None) -> float:
        """Range from which on a reading means no return, m.

        A ROBOTLASER1 line states it. For the older lines it is `SICK_NO_RETURN_M`, or what the log's parameters state
        where that is less: their configurations often have 81.9 or 89 while the readings stop at 81.83.
        """
        if layout is not None:
            return layout.max_m if 0 < layout.max_m < np.inf else SICK_NO_RETURN_M
        stated = self._number(sensor, "max")
        return SICK_NO_RETURN_M if stated is None or stated <= 0 else min(stated, SICK_NO_RETURN_M)

    def _number(self, sensor: str, what: str) -> float | None:
        name = LASER_PARAMETERS.get(sensor, {}).get(what, "")
        if name not in self._parameters:
            return None
        value, line = self._parameters[name]
        try:
            number = float(value)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise InputError(self._path, f"expected a number for the parameter {name}, got {value!r}", line)
        if what in ("x", "y") and not abs(number) < FARTHEST_LASER_M:
            problem = f"expected a laser within {FARTHEST_LASER_M:g} m of the robot by {name}, got {value}"
            raise InputError(self._path, problem, line)
        return number

    def _bearings(self, sensor: str, n: int, layout: BeamLayout | None) -> FloatArray:
        """Return bearings (n,) in rad, counter-clockwise from the right.

        An even number of beams divides the field of view (180 degrees unless stated) into n steps and leaves out its
        last edge, an odd number has a beam on both edges. A stated resolution counts where it fits the number of beams.
        """
        if layout is not None:
            return layout.start_rad + layout.step_rad * np.arange(n, dtype=np.float64)
        if n == 1:
            return np.zeros(1)
        fov = self._number(sensor, "fov") or 180.0
        step = fov / (n - n % 2)
        stated = self._number(sensor, "step")
        if stated is not None and stated > 0 and abs(stated * n - fov) <= 1.5 * stated:
            step = stated
        return np.deg2rad(-fov / 2 + step * np.arange(n, dtype=np.float64))

    def _mounting(self, tag: str, sensor: str, rows: ScanRows) -> Mounting:
        """Where the laser sits: by the lines if they are consistent, else by the parameters, else at the centre."""
        otherwise = {"x": 0.0, "y": 0.0, "theta": np.pi if sensor == "rear" else 0.0}
        stated = {axis: self._number(sensor, axis) for axis in otherwise}
        configured = np.array([otherwise[axis] if value is None else value for axis, value in stated.items()])
        known = any(value is not None for value in stated.values())
        measured = self._offset_in_lines(tag, rows)
        if measured is not None:
            if sensor == "rear" and abs(measured[2]) < np.pi / 2:
                measured[2] = configured[2]  # such a line gives the laser's place, but the robot's heading
            difference = measured - configured
            difference[2] = wrap(difference[2])
            if not known or (np.abs(difference) > _SAME_PLACE).any():
                return Mounting(measured, "line")
        return Mounting(configured, "parameters" if known else "assumed")

    def _offset_in_lines(self, tag: str, rows: ScanRows) -> FloatArray | None:
        """Return pose (3,) of the laser seen from the robot, where the log's lines agree on one.

        The laser's pose in a line is either the robot's composed with the mounting, or a pose that some SLAM corrected.
        Only the former keeps its distance while the robot drives and turns. Equal poses are not informative.
        """
        laser = rows.laser_poses
        if laser is None or rows.robot_poses is None or np.allclose(laser, rows.robot_poses, rtol=0, atol=1e-4):
            return None
        poses = np.array(list(self._poses(tag)))
        if len(poses) == 0:
            return None
        offsets = se2.between(poses[:, 1], poses[:, 0])
        from_first = offsets - offsets[0]
        from_first[:, 2] = wrap(from_first[:, 2])  # a laser that looks backwards must not straddle the cut at pi
        middle = np.median(from_first, axis=0)
        mounting: FloatArray = offsets[0] + middle
        if (np.abs(from_first - middle) > _SAME_PLACE).any() or np.hypot(mounting[0], mounting[1]) >= _FARTHEST_M:
            return None
        mounting[2] = wrap(mounting[2])
        return mounting

    def _poses(self, tag: str) -> Iterator[FloatArray]:
        """Yield laser and robot poses (2, 3) of lines with `tag`, until the robot has driven and turned enough."""
        words_after = 8 if tag == "ROBOTLASER1" else 3
        driven = np.zeros(2)  # m, rad
        last: FloatArray | None = None
        lines = (line for lines in TextSource(self._path) for line in lines if line.startswith(tag + " "))
        for line in islice(lines, _MOST_SCANS):
            words = line.rsplit(None, words_after + 6)[1:7]
            try:
                robot = parse_pose(words[3:])
                yield np.stack([parse_pose(words[:3]), robot])
            except LineError:
                return  # the reader reports the fault of this line
            if last is not None:
                x, y, turned = se2.between(last, robot)
                driven += np.hypot(x, y), abs(turned)
            last = robot
            if (driven >= _ENOUGH_MOTION).all():
                return
