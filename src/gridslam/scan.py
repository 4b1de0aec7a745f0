"""One sweep of a planar lidar: where its beams point, what they measured, and which of them are used.

`gridslam.types` has these names beside the other values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap

__all__ = [
    "BeamEnds", "BeamStatus", "Beams", "EndPoints", "FloatArray", "IntArray", "LaserScan", "Rows", "ScanGeometry",
    "frozen",
]  # fmt: skip

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rows = NDArray[np.integer[Any]]
"""Which map of a table of maps: one row for each pose."""


def frozen(values: ArrayLike, dtype: type, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """A read-only copy of `values` with the given dtype and shape (None: any length)."""
    array: NDArray[Any] = np.array(values, dtype=dtype)
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits:
        raise ArgumentError(name, f"shape {shape} (None: any)", array.shape)
    array.flags.writeable = False
    return array


class BeamStatus(IntEnum):
    """What one beam says; decided once, by the adapter that reads the scan."""

    HIT = 0
    NO_RETURN = 1
    INVALID = 2


_HIT = np.uint8(BeamStatus.HIT)
_DENSE = 400  # beams; a turn of whole degrees, or half a one of half degrees, has no more
_TINY = float(np.finfo(np.float64).tiny)
_STRAIGHT = 1e-12  # rad/s: a turn below this moves nothing by a rounding error


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
        self.bearings: FloatArray = frozen(bearings, np.float64, (None,), "bearings")
        if not np.isfinite(self.bearings).all():
            raise ArgumentError("bearings", "finite angles in rad", "a value that is not finite")
        mounting = np.eye(4) if base_from_laser is None else base_from_laser
        self.base_from_laser: FloatArray = frozen(mounting, np.float64, (4, 4), "base_from_laser")
        rotation = self.base_from_laser[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise ArgumentError("base_from_laser", "a rotation in its upper left 3x3 block", rotation.tolist())
        in_laser = np.stack([np.cos(self.bearings), np.sin(self.bearings), np.zeros_like(self.bearings)])
        self.directions: FloatArray = frozen((rotation @ in_laser)[:2].T, np.float64, (None, 2), "directions")
        self.origin: FloatArray = frozen(self.base_from_laser[:2, 3], np.float64, (2,), "origin")
        gaps = np.abs(wrap(self.bearings - np.roll(self.bearings, 1)))
        self.widths: FloatArray = frozen(gaps, np.float64, (None,), "widths")

    @classmethod
    def planar(cls, bearings: ArrayLike, base_from_laser: ArrayLike) -> ScanGeometry:
        """Geometry of a laser mounted level at the planar pose `base_from_laser` (3,) = [x m, y m, theta rad]."""
        x, y, theta = np.asarray(base_from_laser, dtype=np.float64)
        c, s = np.cos(theta), np.sin(theta)
        return cls(bearings, [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])


@final
@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """One sweep of a planar lidar. Adapters build it; `from_ranges` validates and copies.

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
    range_min_m, range_max_m : float
        Limits of the sensor.
    sensor, frame : str
        Identifier of the laser and name of its frame.
    beam_times_s : (B,) float64 or None
        Time of each beam relative to the stamp.
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
        values = frozen(ranges, np.float64, (len(geometry.bearings),), "ranges")
        no_return = values >= range_max_m if np.isfinite(range_max_m) else np.isposinf(values)
        valid = (values > 0) & (values >= range_min_m)
        status = np.where(valid, np.where(no_return, BeamStatus.NO_RETURN, BeamStatus.HIT), BeamStatus.INVALID)
        times = None if beam_times_s is None else frozen(beam_times_s, np.float64, values.shape, "beam_times_s")
        if times is not None and not np.isfinite(times).all():
            raise ArgumentError("beam_times_s", "finite times in s", "a value that is not finite")
        known = frozen(status, np.uint8, values.shape, "status")
        return cls(int(stamp_ns), values, known, geometry, range_min_m, range_max_m, sensor, frame, times)

    def __len__(self) -> int:
        """Return the number of beams B."""
        return len(self.ranges)

    def beams(self, min_m: float, max_m: float, spacing_m: float = 0.025) -> Beams:
        """Select the beams that hit something at `min_m` <= range < `max_m`, projected to the base frame.

        Of a dense scan only one is taken for each `spacing_m` of arc about the laser, the default being half a cell of
        5 cm; 0 takes all. What is near else outweighs all the rest, and thousands of beams cost time and say the same
        again. Scans of up to 400 such beams are left as they are, and of others about as many are kept at least.
        """
        ranges, geometry = self.ranges, self.geometry
        usable = ((self.status == _HIT) & (ranges >= min_m) & (ranges < max_m)).nonzero()[0]
        if spacing_m and len(usable) > _DENSE:
            usable = usable[self._apart(usable, spacing_m)]
        ends = geometry.directions.take(usable, axis=0)
        ends *= ranges.take(usable)[:, None]
        ends += geometry.origin
        return Beams(self, usable, ends, geometry.origin)

    def _apart(self, usable: IntArray, spacing_m: float) -> NDArray[np.bool_]:
        """Which of the beams are the first ones in equal parts of the arc that they sweep at their ranges."""
        arc = np.cumsum(self.geometry.widths.take(usable) * self.ranges.take(usable))
        part = np.floor(arc / max(min(spacing_m, arc[-1] / _DENSE), _TINY))
        first = np.empty(len(part), bool)
        first[0] = True
        np.not_equal(part[1:], part[:-1], out=first[1:])
        return first


@final
@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The usable beams of a scan in the base frame; what matchers, sensor models and mappers work on.

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

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base; what a map must cover around the pose."""
        return _reach_m(self.ends, self.origin)

    def deskewed(self, twist: FloatArray) -> Beams:
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
            within half the way that the laser made meanwhile, 2 cm at 0.4 m/s and 10 scans a second. The same object
            where the scan has no beam times.

        Source: Sola et al., A micro Lie theory (2018), equations 156 and 158, as complex numbers.
        """
        if self.scan.beam_times_s is None or not len(self.ends):
            return self
        v_x, v_y, omega = twist.tolist()
        times = self.scan.beam_times_s.take(self.indices)
        half_turns = np.empty(len(times), np.complex128)
        half_turns.real, half_turns.imag = np.cos(0.5 * omega * times), np.sin(0.5 * omega * times)
        chords = half_turns.imag * (2 / omega) if abs(omega) > _STRAIGHT else times
        ways, turns = complex(v_x, v_y) * chords * half_turns, half_turns * half_turns
        ends = turns * self.ends.view(np.complex128)[:, 0] + ways
        origin = (turns * complex(*self.origin.tolist()) + ways).mean(keepdims=True)
        return Beams(self.scan, self.indices, ends.view(np.float64).reshape(-1, 2), origin.view(np.float64), omega)


@final
@dataclass(frozen=True, slots=True, eq=False)
class EndPoints:
    """What maps and matchers need of a scan that is long past: ends (K, 2) of its usable beams and origin (2,)."""

    ends: FloatArray
    origin: FloatArray

    def __len__(self) -> int:
        """Return the number of beams K."""
        return len(self.ends)

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base."""
        return _reach_m(self.ends, self.origin)


class BeamEnds(Protocol):
    """Where beams end, seen from the base: `Beams` of a scan at hand, or `EndPoints` of one that was kept."""

    @property
    def ends(self) -> FloatArray:
        """End points (K, 2) in the base frame, m."""

    @property
    def origin(self) -> FloatArray:
        """The laser's place (2,) in the base frame, m."""

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base."""

    def __len__(self) -> int:
        """Return the number of beams K."""


def _reach_m(ends: FloatArray, origin: FloatArray) -> float:
    farthest = np.einsum("ij,ij->i", ends, ends).max(initial=float(origin @ origin))
    return math.sqrt(farthest)
