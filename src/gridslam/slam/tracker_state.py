"""What the tracker remembers between two scans, and what it says of one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.se2 import between, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.odometry_calibration import LearnedOdometry
from gridslam.types import BeamEnds, Beams, FloatArray, Odometry, StoredScan

__all__ = ["Found", "Prediction", "Seen", "Tracked", "TrackerState", "is_within", "pose_of"]

_BOTH = np.array([0, 1], np.int32)
_ROWS = (np.array([0], np.int32), np.array([1], np.int32))


@final
class Seen(NamedTuple):
    """The last of one laser; several take turns, told apart by their scans' `sensor`."""

    stamp_ns: int  # of its last scan that was matched
    matched_pose: FloatArray  # (3,), of that scan
    share: float  # of the beams that agreed with the map then; 0 where it was not believed
    inserted_pose: FloatArray  # (3,), of its last scan that was inserted
    orders: FloatArray  # (3,), what its scans told of the order of their beams; see `Deskew`
    ends: FloatArray = np.zeros((0, 2))  # (K, 2), of that scan, base frame; kept where there are several lasers

    @classmethod
    def first(cls, stamp_ns: int, pose: FloatArray) -> Seen:
        """After its first scan, from `pose` (3,)."""
        return cls(stamp_ns, pose, 1.0, pose, np.zeros(3))


@final
@dataclass(slots=True, eq=False)
class TrackerState:
    """What the tracker remembers; arrays in it are replaced, never written to.

    Attributes
    ----------
    maps : TileMaps
        Two overlapping local maps.
    pose : (3,) float64
        Of the last scan, in the tracker's own, slowly drifting frame.
    stamp_ns : int
        Of the last scan.
    odometry : (3,) float64
        Of the last scan; NaN where it had none.
    matched_pose, matched_odometry : (3,) float64
        Of the last scan that was matched, from which odometry goes on.
    sensors : dict of str to Seen
        The last of each laser.
    learned : LearnedOdometry
        What the odometry's errors are.
    twist : (3,) float64
        Velocity of the base in its own frame, m/s and rad/s.
    spread : (2,) float64
        Variances of what velocities predicted lately, m^2 (each of x and y) and rad^2.
    period_s : float
        Mean time between scans.
    stride : float
        Mean way between scans while the robot moves, m + rad.
    even : bool
        Stamps cannot be true: the time between scans counts as `period_s`.
    active : int
        Which local map is matched against.
    scans : (int, int)
        Scans that each local map holds.
    blind_scans : int
        Scans in a row of whose poses nothing was known, neither by a match nor by odometry.
    overruled : int
        Scans so far whose odometry was not used: it jumped, came late, or is not trusted.
    doubt_m2, doubt_rad2 : float
        Variances of all predictions so far that were taken instead of a match that was not believed.
    """

    maps: TileMaps
    pose: FloatArray
    stamp_ns: int
    odometry: FloatArray
    matched_pose: FloatArray
    matched_odometry: FloatArray
    sensors: dict[str, Seen]
    learned: LearnedOdometry = field(default_factory=LearnedOdometry)
    twist: FloatArray = field(default_factory=lambda: np.zeros(3))
    spread: FloatArray = field(default_factory=lambda: np.array([0.02**2, 0.03**2]))
    period_s: float = 0.1
    stride: float = 0.0
    even: bool = False
    active: int = 0
    scans: tuple[int, int] = (1, 0)
    blind_scans: int = 0
    overruled: int = 0
    doubt_m2: float = 0.0
    doubt_rad2: float = 0.0

    @classmethod
    def start(cls, maps: TileMaps, odometry: Odometry | None, stamp_ns: int, sensor: str) -> TrackerState:
        """Begin at the origin of the tracker's frame."""
        pose, at = np.zeros(3), pose_of(odometry)
        return cls(maps, pose, stamp_ns, at, pose, at, {sensor: Seen.first(stamp_ns, pose)})

    @property
    def row(self) -> NDArray[np.int32]:
        """The local map that is matched against, (1,)."""
        return _ROWS[self.active]

    def note(self, sensor: str, seen: Seen) -> None:
        """Keep the last of a laser; copies that were made before do not change."""
        self.sensors = {**self.sensors, sensor: seen}

    def joined(self, beams: Beams, pose: FloatArray, metres: float, radians: float) -> BeamEnds:
        """The scan, taken at about `pose` (3,), with what the other lasers saw last from no farther away.

        All lasers are one sensor: each alone may see a single wall.
        """
        others = [
            transform_points(between(pose, seen.matched_pose), seen.ends)
            for sensor, seen in self.sensors.items()
            if sensor != beams.scan.sensor and is_within(seen.matched_pose, pose, metres, radians)
        ]
        return StoredScan(np.concatenate([beams.ends, *others]), beams.origin) if others else beams

    def insert(self, beams: Beams, most: int) -> None:
        """Insert a scan at the present pose; the local maps take turns by so many scans of each laser."""
        scans, active, full = list(self.scans), self.active, most * len(self.sensors)
        rows = _ROWS[active] if scans[active] < full else _BOTH
        for row in rows.tolist():
            scans[row] += 1
        self.maps.update(rows, np.repeat(self.pose[None], len(rows), axis=0), beams)
        if scans[1 - active] >= full:
            self.maps.clear(active)
            scans[active], self.active = 0, 1 - active
        self.scans = (scans[0], scans[1])

    def snapshot(self) -> TrackerState:
        """Keep a copy for later, at the cost of the maps' tables."""
        return replace(self, maps=self.maps.snapshot(), learned=self.learned.snapshot())

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays; `from_arrays` continues to the same bytes."""
        arrays: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in _POSES}
        counters = [self.stamp_ns, self.active, *self.scans, self.blind_scans, self.overruled, self.even]
        arrays["counters"] = np.array(counters, np.int64)
        arrays["doubts"] = np.array([self.doubt_m2, self.doubt_rad2])
        arrays["rates"] = np.array([self.period_s, self.stride])
        stamps, *parts, ends = zip(*self.sensors.values(), strict=True)
        arrays["sensors.names"] = np.array(list(self.sensors), np.str_)
        arrays["sensors.stamps_ns"] = np.array(stamps, np.int64)
        arrays |= {f"sensors.{name}": np.array(part) for name, part in zip(_OF_SENSORS, parts, strict=True)}
        arrays["sensors.counts"], arrays["sensors.ends"] = np.array([len(e) for e in ends]), np.concatenate(ends)
        arrays |= {f"learned.{name}": array for name, array in self.learned.to_arrays().items()}
        return arrays | {f"maps.{name}": array for name, array in self.maps.to_arrays().items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping) -> TrackerState:
        """Rebuild from `to_arrays`; raises KeyError where one is missing."""
        maps = mapper.restore({name[5:]: a for name, a in arrays.items() if name.startswith("maps.")})
        learned = LearnedOdometry.from_arrays({n[8:]: a for n, a in arrays.items() if n.startswith("learned.")})
        stamp_ns, active, first, second, blind, overruled, even = (int(v) for v in arrays["counters"])
        doubt_m2, doubt_rad2 = arrays["doubts"].tolist()
        period_s, stride = arrays["rates"].tolist()
        parts = [arrays[f"sensors.{name}"] for name in ("stamps_ns", *_OF_SENSORS)]
        ends = np.split(arrays["sensors.ends"], np.cumsum(arrays["sensors.counts"])[:-1])
        last = [Seen(int(s), pose, float(share), *rest) for s, pose, share, *rest in zip(*parts, ends, strict=True)]
        return cls(
            maps, stamp_ns=stamp_ns, learned=learned,
            sensors=dict(zip(arrays["sensors.names"].tolist(), last, strict=True)),
            period_s=period_s, stride=stride, even=bool(even), active=active, scans=(first, second),
            blind_scans=blind, overruled=overruled, doubt_m2=doubt_m2, doubt_rad2=doubt_rad2,
            **{name: np.array(arrays[name], np.float64) for name in _POSES},
        )  # fmt: skip


_OF_SENSORS = ("matched_poses", "shares", "inserted_poses", "orders")
_POSES = ("pose", "odometry", "matched_pose", "matched_odometry", "twist", "spread")


def is_within(a: FloatArray, b: FloatArray, metres: float, radians: float) -> bool:
    """Whether poses (3,) are nearer to each other than both."""
    dx, dy, turn = (a - b).tolist()
    return math.hypot(dx, dy) < metres and abs(math.remainder(turn, math.tau)) < radians


def pose_of(odometry: Odometry | None) -> FloatArray:
    """Pose (3,); NaN where there is none."""
    return np.full(3, np.nan) if odometry is None else odometry.pose


@final
class Prediction(NamedTuple):
    """Where a scan should have been taken, by all that is known without looking at it."""

    pose: FloatArray  # (3,)
    by_odometry: bool  # or by the velocity
    seconds: float  # since the last scan
    moved_m: float  # since the last scan that was matched, by the odometry; 0 without
    turned_rad: float  # since the last scan that was matched
    sigma_m: float
    sigma_rad: float
    beam_sigma_m: float  # that of a beam, against which the prediction is weighed

    @property
    def prior(self) -> FloatArray:
        """Information (1, 3, 3) of the prediction, beside residuals in m."""
        position, heading = (self.beam_sigma_m / self.sigma_m) ** 2, (self.beam_sigma_m / self.sigma_rad) ** 2
        return np.array([[[position, 0.0, 0.0], [0.0, position, 0.0], [0.0, 0.0, heading]]])


@final
class Found(NamedTuple):
    """Where a scan was taken."""

    pose: FloatArray  # (3,)
    predicted: Prediction  # from which it was found
    matched: bool  # whether the map was asked
    poor: bool  # nothing that is known of the pose is to be trusted
    share: float = 0.0  # of the beams that agree with the map; 0 where the match is not believed
    determined: bool = False  # by the scan, in all directions


@final
@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the tracker says of one scan.

    Attributes
    ----------
    pose, predicted : (3,) float64
        In the tracker's frame; `predicted` uses only the scans before this one, `pose` this one too. Where scans are
        far apart `predicted` may be a guess from this scan, to descend from.
    beams : Beams
        As seen from the base at the stamp: deskewed.
    joint : BeamEnds
        These, and what the other lasers saw a moment ago: what is to be matched.
    spread : (2,) float64 or None
        Variances of a prediction by the velocity, m^2 (each of x and y) and rad^2; None by odometry, whose noise is the
        motion model's.
    """

    pose: FloatArray
    predicted: FloatArray
    beams: Beams
    joint: BeamEnds
    spread: FloatArray | None = None
