"""One scan of a planar lidar: directions and ranges of its beams, and the selection of usable ones."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import freeze, require_array, require_instance
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.rigid import matrix_of_planar
from gridslam.parameters import bounded, parameters

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
Rows = NDArray[np.integer[Any]]
"""Which map of a table of maps: one row for each pose."""
Poses = Annotated[FloatArray, "K", 3]
Points = Annotated[FloatArray, "B", 2]
"""Poses or points; all arguments with the same annotation have the same number of rows."""


@final
@checked
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
        return cls(bearings, matrix_of_planar(freeze(base_from_laser, np.float64, (3,), "base_from_laser")))


_LITTLE = 1 / 3  # of a scan's beams
_APART_M = 0.5  # neighbouring ends that are farther apart are of two things
_FEW_THINGS = 3
_ONE_THING_M = 0.5  # root mean square distance of its ends from their middle; walls spread over metres
_STRAIGHT = 1e-12  # rad/s: a turn below this moves nothing by a rounding error


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The usable beams of a scan in the base frame; the input of matchers, sensor models and mappers.

    Attributes
    ----------
    scan : LaserScan
        Where they come from.
    indices : (K,) int64
        Which beams of the scan they are.
    ends : (K, 2) float64, m
        End points in the base frame.
    origin : (2,) float64, m
        The laser's place in the base frame.
    turn_rate_rps : float, rad/s
        Turn of the base during the scan that is undone in them; 0 where none is.
    """

    scan: LaserScan
    indices: IntArray
    ends: FloatArray
    origin: FloatArray
    turn_rate_rps: float = 0.0

    def __len__(self) -> int:
        """Return the number of usable beams K."""
        return len(self.ends)

    def __repr__(self) -> str:
        """Return one line."""
        return f"Beams({len(self)} of {len(self.scan)}, up to {self.reach_m:.2f} m)"

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base; a map must cover this radius around the pose."""
        return _reach_m(self.ends, self.origin)

    @property
    def shows_one_thing(self) -> bool:
        """Whether all that is seen, over a third of the view at most, is one thing of a person's size.

        Such a thing may move by itself, and the beams that hit it are no independent evidence of the robot's motion.
        """
        if not 0 < len(self) < _LITTLE * len(self.scan):
            return False
        return bool(self.ends.var(axis=0).sum() < _ONE_THING_M**2)

    def without_movable(self) -> Beams:
        """Leave out things that may move by themselves: one to three of a person's size, where little else is seen.

        Of scans that show something over a third of the view at most. Four things are mostly trees or columns, or a
        wall so far away that beams hit it metres apart.
        """
        if not 0 < len(self) < _LITTLE * len(self.scan):
            return self
        gaps = np.flatnonzero(np.hypot(*np.diff(self.ends, axis=0).T) > _APART_M) + 1
        things = np.split(np.arange(len(self)), gaps)
        small = [own for own in things if self.ends[own].var(axis=0).sum() < _ONE_THING_M**2]
        if not 0 < len(small) <= _FEW_THINGS:
            return self
        kept = np.setdiff1d(np.arange(len(self)), np.concatenate(small))
        return Beams(self.scan, self.indices[kept], self.ends[kept], self.origin)

    def deskew(self, twist: FloatArray) -> Beams:
        """Undo the robot's motion during the scan: all beams as if they had been measured at the scan's stamp.

        A beam that was measured t seconds after the stamp left the laser, and ended, where the base then was: both lie
        at exp(t twist) from the base at the stamp. To be applied once, to beams as `LaserScan.beams` selects them.

        Parameters
        ----------
        twist : (3,) float64
            Motion of the base, [v_x m/s, v_y m/s, omega rad/s] in its own frame, taken as constant during the scan.

        Returns
        -------
        Beams
            With exact ends. All rays begin at one `origin`, the mean of the laser's places: rays of a scan leave from
            within half the path of the laser during the scan, 2 cm at 0.4 m/s and 10 scans a second. The same object
            where the scan has no beam times.

        References
        ----------
        Sola et al., A micro Lie theory (2018), equations 156 and 158, as complex numbers.
        """
        if self.scan.beam_times_s is None or not len(self.ends):
            return self
        v_x, v_y, omega = twist.tolist()
        times = self.scan.beam_times_s.take(self.indices)
        half_turns = np.empty(len(times), np.complex128)
        half_turns.real = np.cos(0.5 * omega * times)
        half_turns.imag = np.sin(0.5 * omega * times)
        chords = half_turns.imag * (2 / omega) if abs(omega) > _STRAIGHT else times
        ways = complex(v_x, v_y) * chords * half_turns
        turns = half_turns * half_turns
        ends = turns * self.ends.view(np.complex128)[:, 0] + ways
        origin = (turns * complex(*self.origin.tolist()) + ways).mean(keepdims=True)
        return Beams(self.scan, self.indices, ends.view(np.float64).reshape(-1, 2), origin.view(np.float64), omega)


@final
@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """End points (K, 2) of the usable beams and origin (2,) of a stored scan."""

    ends: FloatArray
    origin: FloatArray

    def __len__(self) -> int:
        """Return the number of beams K."""
        return len(self.ends)

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base."""
        return _reach_m(self.ends, self.origin)


BeamEnds: TypeAlias = Beams | StoredScan
"""Where beams end, seen from the base: `Beams` of a scan at hand, or `StoredScan` of one that was kept."""


def _reach_m(ends: FloatArray, origin: FloatArray) -> float:
    farthest = np.einsum("ij,ij->i", ends, ends).max(initial=float(origin @ origin))
    return math.sqrt(farthest)


_TINY = float(np.finfo(np.float64).tiny)


_SPACING_M = 0.025
"""Arc for which one beam of a dense scan is taken; half a cell of 5 cm, so that every cell of a wall is still hit."""


@final
@parameters(frozen=True)
class Thinning:
    """Takes of a dense scan only one beam for each bit of arc about the laser.

    Otherwise near structure outweighs all the rest, and thousands of beams cost time without new information.

    Parameters
    ----------
    dense_beams : int, >= 1
        A scan of more usable beams is dense, and about as many are kept at least: a turn of whole degrees, or half a
        one of half degrees, has no more, and is used as it is. A number that no scan reaches takes all.
    """

    dense_beams: int = bounded(400, ge=1, le=1_000_000)

    def __call__(self, ranges: FloatArray, widths: FloatArray) -> NDArray[np.bool_] | None:
        """Return which beams to take: the first ones in equal parts of the arc that they sweep; None for all.

        Parameters
        ----------
        ranges : (K,) float64, m
            Of the usable beams, in their order.
        widths : (K,) float64, rad
            Angle between each beam of these and the one before it in the scan.
        """
        if len(ranges) <= self.dense_beams:
            return None
        arc = np.cumsum(widths * ranges)
        part = np.floor(arc / max(min(_SPACING_M, arc[-1] / self.dense_beams), _TINY))
        first = np.empty(len(part), bool)
        first[0] = True
        np.not_equal(part[1:], part[:-1], out=first[1:])
        return first


LONGEST_SCAN_S = 10.0
"""No planar laser takes this long for a scan: such beam times are invalid."""

_FARTHEST_M = 200.0  # a planar lidar sees no farther
_SMALLEST = 5e-324  # a range of 0 is none


class BeamStatus(IntEnum):
    """Status of a beam, set once by the reader of the scan."""

    HIT = 0
    NO_RETURN = 1
    INVALID = 2


_HIT = np.uint8(BeamStatus.HIT)
_GREATEST = int(max(BeamStatus))


@final
@checked
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
        `range_max_m` are NO_RETURN. Warns of bearings that look like degrees and of ranges that look like millimetres.
        Raises ArgumentError where lengths differ, a beam's time is not finite or `stamp_ns` is no integer, such as a
        time in seconds.
        """
        scan = cls.from_log(
            stamp_ns,
            ranges,
            geometry,
            range_min_m=range_min_m,
            range_max_m=range_max_m,
            sensor=sensor,
            frame=frame,
            beam_times_s=beam_times_s,
        )
        _warn_of_units(scan)
        return scan

    @classmethod
    def from_log(
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
        """Build a scan as `from_ranges` does, without its warnings: the doctor finds wrong units in logs."""
        if not isinstance(stamp_ns, int | np.integer):
            raise ArgumentError("stamp_ns", "an integer of ns, such as int(1e9 * seconds)", stamp_ns)
        require_instance("geometry", geometry, ScanGeometry)
        with np.errstate(invalid="ignore"):  # of NaNs that signal
            values = freeze(ranges, np.float64, (len(geometry.bearings),), "ranges")
        status = (values >= range_max_m).view(np.uint8)  # 0 and 1: HIT and NO_RETURN
        status[~(values >= (range_min_m or _SMALLEST))] = BeamStatus.INVALID
        status.flags.writeable = False
        times = None if beam_times_s is None else freeze(beam_times_s, np.float64, values.shape, "beam_times_s")
        if times is not None and not np.isfinite(times).all():
            raise ArgumentError("beam_times_s", "finite times in s", "a value that is not finite")
        return cls(int(stamp_ns), values, status, geometry, range_min_m, range_max_m, sensor, frame, times)

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
        count = np.size(ranges)
        if geometry is None:
            if not math.isfinite(angle_min + angle_increment):
                got = f"{angle_min} rad in steps of {angle_increment} rad"
                raise ArgumentError("angle_min, angle_increment", "finite angles in rad", got)
            geometry = ScanGeometry(angle_min + angle_increment * np.arange(count), base_from_laser)
        is_timed = time_increment > 0 and time_increment * count < LONGEST_SCAN_S
        times = np.arange(count) * time_increment if is_timed else None
        return cls.from_log(
            stamp_ns,
            ranges,
            geometry,
            range_min_m=lower,
            range_max_m=upper,
            sensor=sensor,
            frame=frame,
            beam_times_s=times,
        )

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
        geometry = self.geometry
        usable = ((self.status == _HIT) & (self.ranges >= min_m) & (self.ranges < max_m)).nonzero()[0]
        ends = geometry.directions.take(usable, axis=0) * self.ranges.take(usable)[:, None] + geometry.origin
        if len(usable) > thinning.dense_beams:
            taken = thinning(self.ranges[usable], geometry.widths[usable])
            if taken is not None:
                usable = usable[taken]
                ends = ends[taken]
        return Beams(self, usable, ends, geometry.origin)


def _warn_of_units(scan: LaserScan) -> None:
    """Warn of bearings that look like degrees, and of ranges that look like millimetres: no planar lidar has such."""
    bearings = scan.geometry.bearings
    if len(bearings) and np.abs(bearings[[0, -1]]).max() > 2 * math.tau:
        message = f"bearings reach {np.abs(bearings).max():.0f} rad: are they in degrees? Expected rad"
        warnings.warn(message, UserWarning, stacklevel=3)
    hits = scan.ranges[scan.status == _HIT]
    if 2 * np.count_nonzero(hits > _FARTHEST_M) > len(hits):
        message = f"ranges have a median of {np.median(hits):.0f} m: are they in millimetres? Expected m"
        warnings.warn(message, UserWarning, stacklevel=3)
