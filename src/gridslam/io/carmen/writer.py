"""Writer of CARMEN logs, and conversion of measurements to values that CARMEN can represent."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import se2, se3
from gridslam.io.carmen.lasers import LASER_PARAMETERS, SICK_NO_RETURN_M
from gridslam.io.measurement import Measurement
from gridslam.io.output import open_for_writing, write_atomically
from gridslam.io.tables import format_stamp_ns
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["to_carmen_form", "write_carmen"]

_SENSORS = "front", "rear"
_HEADER = """\
# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp
# message formats defined: PARAM ODOM FLASER RLASER
# PARAM param_name param_value
# ODOM x y theta tv rv accel
# FLASER num_readings [range_readings] x y theta odom_x odom_y odom_theta
# RLASER num_readings [range_readings] x y theta odom_x odom_y odom_theta
"""
_NO_RETURN_TEXT = "81.910"


def write_carmen(path: str | Path, measurements: Iterable[Measurement]) -> None:
    """Write a log that `CarmenLog` reads back: an ODOM and a FLASER (sensor "rear": RLASER) line for each measurement.

    Stamps come back exactly, ranges to 1 mm, poses to 1e-6 m and rad, each beam's status as it was. Field of view,
    maximum range and mounting are stated as parameters. The file appears under its name only once it is whole.

    A log that begins without odometry is written in the older form, whose scans have the odometry of the last ODOM line
    before them, with its own stamp.

    Parameters
    ----------
    path : str or Path
        Compressed where its suffix is .gz or .bz2.
    measurements : iterable of Measurement
        In the order in which they are to stand in the log; may be a generator.

    Raises
    ------
    ArgumentError
        For data that the format cannot represent: odometry that is not at the scan's stamp or ends (but see above),
        beams not evenly spread about the laser's axis, a laser not mounted level, hits at or above the maximum range or
        81.83 m.
    OutputError
        Where the file cannot be written.
    """
    with write_atomically(path) as aside, open_for_writing(aside, Path(path).suffix) as file:
        file.writelines(text.encode() for text in _format_lines(measurements))


def _format_lines(measurements: Iterable[Measurement]) -> Iterator[str]:
    """Yield the lines of a log, in the form that the first measurement asks for."""
    yield _HEADER
    stated: dict[str, list[str]] = {}
    written: Odometry | None = None
    start_ns: int | None = None
    posed = False
    for odometry, scan in measurements:
        if start_ns is None:
            start_ns = scan.stamp_ns
            posed = odometry is not None
        if posed and (odometry is None or odometry.stamp_ns != scan.stamp_ns):
            got = None if odometry is None else odometry.stamp_ns
            raise ArgumentError("measurements", f"odometry at the scan's stamp {scan.stamp_ns}", got)
        if odometry is None and written is not None:
            raise ArgumentError("measurements", "odometry with every scan after the first that has some", None)
        sensor = "rear" if scan.sensor == "rear" else "front"
        parameters = _parameters(sensor, scan.geometry, scan.range_max_m)
        if stated.get(sensor) != parameters:
            yield from parameters
            stated[sensor] = parameters
        poses = ""
        if odometry is not None:
            robot = _pose(odometry.pose)
            if odometry is not written:
                yield f"ODOM {robot} 0 0 0 {_tail(odometry.stamp_ns, start_ns)}"
                written = odometry
            if posed:
                poses = f"{_pose(se2.compose(odometry.pose, _mounting(scan.geometry)))} {robot} "
        tag = "RLASER" if sensor == "rear" else "FLASER"
        yield f"{tag} {len(scan)} {_ranges(scan)} {poses}{_tail(scan.stamp_ns, start_ns)}"


@lru_cache(maxsize=256)
def _parameters(sensor: str, geometry: ScanGeometry, range_max_m: float) -> list[str]:
    """PARAM lines from which the reader gets the beams, the maximum range and the mounting."""
    values: dict[str, float] = dict(zip(("x", "y", "theta"), _mounting(geometry), strict=True))
    bearings = geometry.bearings
    n = len(bearings)
    if n > 1:
        step, fov = _spread(bearings)
        if not np.allclose(bearings, bearings[0] + step * np.arange(n), rtol=0, atol=1e-6) or not step > 0:
            raise ArgumentError("bearings", "evenly spread, counter-clockwise", bearings)
        if not (fov > 0 and abs(step * n - fov) <= 1.5 * step):
            got = (float(bearings[0]), float(bearings[-1]))
            raise ArgumentError("bearings", "from -fov/2 to fov/2, with or without the last edge", got)
        values |= {"fov": float(np.rad2deg(fov)), "step": float(np.rad2deg(step))}
    values["max"] = min(range_max_m, SICK_NO_RETURN_M)
    return [f"PARAM {LASER_PARAMETERS[sensor][what]} {value!r} nohost 0\n" for what, value in values.items()]


@lru_cache(maxsize=256)
def _mounting(geometry: ScanGeometry) -> tuple[float, float, float]:
    mounting = geometry.base_from_laser
    if not np.allclose(mounting[2, :3], (0, 0, 1), atol=1e-9):
        raise ArgumentError("base_from_laser", "a laser mounted level", mounting.tolist())
    return float(mounting[0, 3]), float(mounting[1, 3]), float(np.arctan2(mounting[1, 0], mounting[0, 0]))


def _spread(bearings: FloatArray) -> tuple[float, float]:
    """Step of two beams or more, and their field of view if it lies about the axis, rad."""
    return float(bearings[-1] - bearings[0]) / (len(bearings) - 1), -2 * float(bearings[0])


def _tail(stamp_ns: int, start_ns: int) -> str:
    return f"{format_stamp_ns(stamp_ns)} nohost {(stamp_ns - start_ns) / 1e9:.6f}\n"


def _pose(pose: FloatArray) -> str:
    return "{:.6f} {:.6f} {:.6f}".format(*pose)


def _ranges(scan: LaserScan) -> str:
    limit = min(scan.range_max_m, SICK_NO_RETURN_M)
    hit = scan.status == BeamStatus.HIT
    if (scan.ranges[hit] >= limit).any():
        raise ArgumentError("ranges", f"hits below {limit} m", scan.ranges[hit].max())
    # Rounding must not turn a hit into "no return" or "invalid".
    millimetres = np.clip(np.rint(1000 * np.where(hit, scan.ranges, 1.0)), 1, np.ceil(1000 * limit) - 1)
    texts = ("%.3f " * len(scan) % tuple(millimetres / 1000)).split()
    for beam in np.flatnonzero(~hit):
        texts[beam] = _NO_RETURN_TEXT if scan.status[beam] == BeamStatus.NO_RETURN else "0.000"
    return " ".join(texts)


def to_carmen_form(measurements: Iterable[Measurement], lost: Counter[str]) -> Iterator[Measurement]:
    """Change measurements so that `write_carmen` can write them; count the scans with lost data, by its name.

    A laser that is level but upside down, clockwise or not symmetric about its axis becomes one that is upright,
    counter-clockwise and symmetric, with the very same beams. Scans without odometry after one with odometry are left
    out; odometry takes the scan's stamp.

    Raises
    ------
    ArgumentError
        For what has no such form: a laser that is tilted, beams not evenly spread, more than two lasers.
    """
    names: dict[str, str] = {}
    posed: bool | None = None
    odometry_began = False
    for odometry, scan in measurements:
        posed = odometry is not None if posed is None else posed
        if odometry is None and odometry_began:
            lost["scans without odometry"] += 1
            continue
        odometry_began = odometry_began or odometry is not None
        if odometry is not None and posed:
            lost["more than 6 decimals of poses"] += _rounds(1e6 * odometry.pose, 1e-3)
            if odometry.stamp_ns != scan.stamp_ns:
                lost["the odometry's own stamps"] += 1
                odometry = Odometry(scan.stamp_ns, odometry.pose)
        yield Measurement(odometry, _form_scan(scan, _name(scan.sensor, names), lost))


def _name(sensor: str, names: dict[str, str]) -> str:
    """Name of a laser in the log, decided once for each."""
    if sensor not in names:
        free = [name for name in _SENSORS if name not in names.values()]
        if not free:
            raise ArgumentError("measurements", "two lasers at most (choose with --scan)", [*names, sensor])
        names[sensor] = sensor if sensor in free else free[0]
    return names[sensor]


def _form_scan(scan: LaserScan, name: str, lost: Counter[str]) -> LaserScan:
    lost[f"the name of the laser ({scan.sensor} is {name} now)"] += name != scan.sensor
    lost["times of beams"] += scan.beam_times_s is not None
    geometry, order = _symmetric(scan.geometry)
    ranges = scan.ranges[::order]
    status = scan.status[::order]
    hit = status == BeamStatus.HIT
    far = hit & (ranges >= SICK_NO_RETURN_M)
    if far.any():
        lost[f"ranges from {SICK_NO_RETURN_M} m on"] += 1
        status = np.where(far, np.uint8(BeamStatus.NO_RETURN), status)
    lost["more than 3 decimals of ranges"] += _rounds(1e3 * ranges[hit & ~far], 1e-6)
    return replace(scan, ranges=ranges, status=status, geometry=geometry, sensor=name, beam_times_s=None)


def _rounds(values: FloatArray, tolerance: float) -> bool:
    return bool((abs(values - np.rint(values)) > tolerance).any())


@lru_cache(maxsize=256)
def _symmetric(geometry: ScanGeometry) -> tuple[ScanGeometry, int]:
    """A level geometry as an upright, counter-clockwise one that is symmetric about its axis, and its beams' order."""
    rotation = geometry.base_from_laser[:3, :3]
    if abs(abs(rotation[2, 2]) - 1) > 1e-6:
        tilt = se3.tilt_rad(geometry.base_from_laser)
        got = f"one tilted by {math.degrees(min(tilt, math.pi - tilt)):.1f} degrees"
        raise ArgumentError("base_from_laser", "a laser mounted level, upright or upside down", got)
    upright = rotation[2, 2] > 0
    bearings = geometry.bearings if upright else -geometry.bearings  # seen from above the beams run the other way
    order = -1 if bearings[-1] < bearings[0] else 1
    bearings = bearings[::order]
    if upright and order == 1 and _has_carmen_form(bearings):
        return geometry, order
    middle = (bearings[0] + bearings[-1]) / 2
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0]) + middle
    return ScanGeometry.planar(bearings - middle, [*geometry.origin, yaw]), order


def _has_carmen_form(bearings: FloatArray) -> bool:
    """Return whether the beams lie about the axis as CARMEN has them: from -fov/2 on, with or without the last edge."""
    if len(bearings) == 1:
        return bool(bearings[0] == 0)
    step, fov = _spread(bearings)
    return fov > 0 and abs(step * len(bearings) - fov) <= 1.4 * step
