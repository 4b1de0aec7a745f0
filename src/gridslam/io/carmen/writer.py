"""Writer of CARMEN logs, for those that are simulated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.io.carmen.lasers import LASER_PARAMETERS, SICK_NO_RETURN_M
from gridslam.io.even_beams import find_step
from gridslam.io.measurement import Measurement
from gridslam.io.output import open_for_writing, write_atomically
from gridslam.io.tables import format_stamp_ns
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

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
        first, step = find_step("bearings", bearings, 1e-6)
        fov = -2 * first
        if not (step > 0 and fov > 0 and abs(step * n - fov) <= 1.5 * step):
            got = (float(bearings[0]), float(bearings[-1]))
            raise ArgumentError(
                "bearings", "counter-clockwise from -fov/2 to fov/2, with or without the last edge", got
            )
        values |= {"fov": float(np.rad2deg(fov)), "step": float(np.rad2deg(step))}
    values["max"] = min(range_max_m, SICK_NO_RETURN_M)
    return [f"PARAM {LASER_PARAMETERS[sensor][what]} {value!r} nohost 0\n" for what, value in values.items()]


@lru_cache(maxsize=256)
def _mounting(geometry: ScanGeometry) -> tuple[float, float, float]:
    mounting = geometry.base_from_laser
    if not np.allclose(mounting[2, :3], (0, 0, 1), atol=1e-9):
        raise ArgumentError("base_from_laser", "a laser mounted level", mounting.tolist())
    return float(mounting[0, 3]), float(mounting[1, 3]), float(np.arctan2(mounting[1, 0], mounting[0, 0]))


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
