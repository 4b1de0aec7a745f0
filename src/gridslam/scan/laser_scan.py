"""One sweep of a planar lidar, checked once when it is made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import freeze, require_array, require_instance
from gridslam.errors import ArgumentError
from gridslam.scan.arrays import FloatArray
from gridslam.scan.beams import Beams
from gridslam.scan.geometry import ScanGeometry
from gridslam.scan.thinning import Thinning

__all__ = ["LONGEST_SCAN_S", "BeamStatus", "LaserScan"]

LONGEST_SCAN_S = 10.0
"""No planar laser takes this long for a scan: such beam times are invalid."""

_SMALLEST = 5e-324  # a range of 0 is none


class BeamStatus(IntEnum):
    """Status of a beam, set once by the reader of the scan."""

    HIT = 0
    NO_RETURN = 1
    INVALID = 2


_HIT, _GREATEST = np.uint8(BeamStatus.HIT), int(max(BeamStatus))


@final
@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """One sweep of a planar lidar; `from_ranges` builds it from ranges, `from_ros` from the fields of a ROS message.

    The constructor takes arrays as they are, and checks that they belong together.

    Attributes
    ----------
    stamp_ns : int
        Time of the scan, ns.
    ranges : (B,) float64, m
        Measured ranges; meaningful where `status` is HIT.
    status : (B,) uint8
        A `BeamStatus` for each beam.
    geometry : ScanGeometry
        Bearings and mounting; its length is B.
    range_min_m, range_max_m : float, m
        Limits of the sensor, 0 <= range_min_m < range_max_m; `range_max_m` may be infinite.
    sensor, frame : str
        Identifier of the laser and name of its frame.
    beam_times_s : (B,) float64 or None
        Time of each beam relative to the stamp.

    Raises
    ------
    ArgumentError
        An argument is of another type, shape or range.
    """

    stamp_ns: int
    ranges: FloatArray
    status: NDArray[np.uint8]
    geometry: ScanGeometry
    range_min_m: float = 0.0
    range_max_m: float = np.inf
    sensor: str = "laser"
    frame: str = "laser"
    beam_times_s: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check that all belongs together."""
        require_instance("stamp_ns", self.stamp_ns, int, np.integer)
        require_instance("geometry", self.geometry, ScanGeometry)
        shape = self.geometry.bearings.shape
        require_array("ranges", self.ranges, np.float64, shape)
        require_array("status", self.status, np.uint8, shape)
        if (greatest := int(self.status.max(initial=0))) > _GREATEST:
            raise ArgumentError("status", "values of BeamStatus: 0, 1 or 2", greatest)
        if not 0 <= self.range_min_m < math.inf:
            raise ArgumentError("range_min_m", "a finite number >= 0", self.range_min_m)
        if not self.range_max_m > self.range_min_m:
            raise ArgumentError("range_max_m", f"a number > range_min_m, {self.range_min_m:g}", self.range_max_m)
        if self.beam_times_s is not None:
            require_array("beam_times_s", self.beam_times_s, np.float64, shape)

    @classmethod
    def from_ranges(
        cls,
        stamp_ns: int,
        ranges: ArrayLike,
        geometry: ScanGeometry,
        *,
        range_min_m: float = 0.0,
        range_max_m: float = np.inf,
        sensor: str = "laser",
        frame: str = "laser",
        beam_times_s: ArrayLike | None = None,
    ) -> LaserScan:
        """Build a scan from raw ranges (B,) in m, deciding each beam's status.

        NaN, negative and zero ranges and ranges below `range_min_m` are INVALID; infinite ones and those at or above
        `range_max_m` are NO_RETURN. Raises ArgumentError where lengths differ or a beam's time is not finite.
        """
        require_instance("geometry", geometry, ScanGeometry)
        values = freeze(ranges, np.float64, (len(geometry.bearings),), "ranges")
        no_return = values >= range_max_m if np.isfinite(range_max_m) else np.isposinf(values)
        valid = (values > 0) & (values >= range_min_m)
        status = np.where(valid, np.where(no_return, BeamStatus.NO_RETURN, BeamStatus.HIT), BeamStatus.INVALID)
        times = None if beam_times_s is None else freeze(beam_times_s, np.float64, values.shape, "beam_times_s")
        if times is not None and not np.isfinite(times).all():
            raise ArgumentError("beam_times_s", "finite times in s", "a value that is not finite")
        known = freeze(status, np.uint8, values.shape, "status")
        return cls(int(stamp_ns), values, known, geometry, range_min_m, range_max_m, sensor, frame, times)

    @classmethod
    def from_ros(  # noqa: PLR0913 the message's fields, by their names
        cls,
        stamp_ns: int,
        ranges: ArrayLike,
        *,
        angle_min: float,
        angle_increment: float,
        range_min: float = 0.0,
        range_max: float = np.inf,
        time_increment: float = 0.0,
        base_from_laser: ArrayLike | None = None,
        geometry: ScanGeometry | None = None,
        sensor: str = "laser",
        frame: str = "laser",
    ) -> LaserScan:
        """Build a scan from the fields of a sensor_msgs/LaserScan, as they stand in the message.

        Parameters
        ----------
        stamp_ns : int, ns
            Of the header: ``stamp.sec * 10**9 + stamp.nanosec``.
        ranges : (B,) float, m
            By the rules of `from_ranges`.
        angle_min, angle_increment : float, rad
            Bearing of the first beam in the laser's frame, and from each beam to the next; counter-clockwise.
        range_min, range_max : float, m
            A maximum that is not above the minimum and 0 is no maximum; a minimum below 0, NaN or infinite is none.
        time_increment : float, s
            From each beam to the next; 0 where it is not known. One by which the scan takes 10 s or more is none.
        base_from_laser : (4, 4) float64, optional
            Mounting as for `ScanGeometry`; identity if not given.
        geometry : ScanGeometry, optional
            That of an earlier scan with the same angles and mounting, to be shared; else it is made of them.
        sensor, frame : str
            The topic and the header's frame.

        Raises
        ------
        ArgumentError
            An angle is not finite, or the ranges are no (B,) numbers.
        """
        lower = float(range_min) if 0 < range_min < math.inf else 0.0
        upper = float(range_max) if range_max > lower else math.inf
        with np.errstate(invalid="ignore"):  # of NaNs that signal
            values = freeze(ranges, np.float64, (None,), "ranges")
        if geometry is None:
            if not math.isfinite(angle_min + angle_increment):
                got = f"{angle_min} rad in steps of {angle_increment} rad"
                raise ArgumentError("angle_min, angle_increment", "finite angles in rad", got)
            geometry = ScanGeometry(angle_min + angle_increment * np.arange(len(values)), base_from_laser)
        status = (values >= upper).view(np.uint8)  # 0 and 1: HIT and NO_RETURN
        status[~(values >= (lower or _SMALLEST))] = BeamStatus.INVALID
        status.flags.writeable = False
        times = None
        if time_increment > 0 and time_increment * len(values) < LONGEST_SCAN_S:
            times = np.arange(len(values), dtype=np.float64) * time_increment
            times.flags.writeable = False
        return cls(stamp_ns, values, status, geometry, lower, upper, sensor, frame, times)

    def __len__(self) -> int:
        """Return the number of beams B."""
        return len(self.ranges)

    def __repr__(self) -> str:
        """Return one line."""
        hits = self.ranges[self.status == _HIT]
        reach = f" of {hits.min():.2f} to {hits.max():.2f} m" if len(hits) else ""
        return f"LaserScan({self.sensor}, {self.stamp_ns * 1e-9:.3f} s: {len(self)} beams, {len(hits)} hits{reach})"

    def beams(self, min_m: float, max_m: float, thinning: Thinning = Thinning()) -> Beams:
        """Select the beams that hit something at `min_m` <= range < `max_m`, projected to the base frame.

        Dense scans are thinned by `thinning`.
        """
        ranges, geometry = self.ranges, self.geometry
        usable = ((self.status == _HIT) & (ranges >= min_m) & (ranges < max_m)).nonzero()[0]
        taken = thinning(ranges.take(usable), geometry.widths.take(usable))
        if taken is not None:
            usable = usable[taken]
        ends = geometry.directions.take(usable, axis=0)
        ends *= ranges.take(usable)[:, None]
        ends += geometry.origin
        return Beams(self, usable, ends, geometry.origin)
