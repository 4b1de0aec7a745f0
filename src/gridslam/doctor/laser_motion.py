"""The motion of a laser through a log, and the corresponding odometry."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.laser_odometry import LaserOdometry
from gridslam.doctor.lasers import planar_mounting
from gridslam.geometry.se2 import adjoint
from gridslam.io.measurement import Measurement
from gridslam.matching.gauss_newton import MIN_INFORMATION
from gridslam.types import FloatArray, IntArray, LaserScan, ScanGeometry

_MOST_BEAMS = 360
RANGES_M = (0.05, 30.0)
_FEWEST_BEAMS = 20
_MOST_SCANS = 20_000  # matched: a quarter of an hour at 20 Hz shows what is wrong
_BEAM_SIGMA_M = 0.06  # of a beam against the local map, correlation of neighbours included
_FLOOR_M = 0.004  # what the grid of the map costs, and
_FLOOR_RAD = 0.001


@final
@dataclass(frozen=True, slots=True, eq=False)
class LaserMotion:
    """Poses of one laser found by scan matching alone, with the odometry of the same scans.

    The frame is the laser's own as its geometry declares it, level, with x where bearing 0 points; only the direction
    of its yaw is left out. So a laser that is mounted as declared gives `mounting`, and any other pose is a fault.

    Attributes
    ----------
    sensor : str
    stamps_ns : (K,) int64
        Of the poses, in the log's order: of the scan, or the mean time of its beams where each has one.
    poses : (K, 3) float64
        Of the laser, in a frame of its own for each track.
    covariances : (K, 3, 3) float64
        Of the poses, in the laser's frame at each; 1 m^2 in directions that the scan does not determine.
    shares : (K,) float64
        Of beams that agree with the match, in [0, 1]; 0 where a track begins.
    tracks : (K,) int64
        Increments between poses of different tracks are unknown: the match was lost, or scans were passed over.
    odometry : (K, 3) float64
        Pose of the robot as the log has it for the scan; NaN where there is none.
    odometry_stamps_ns : (K,) int64
        The stamps of `odometry`.
    mounting : (3,) float64
        Pose of the laser in the base frame as the log declares it, [x m, y m, yaw rad].
    upside_down : bool
        Whether the log declares that the laser's z axis points downwards.
    """

    sensor: str
    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray
    shares: FloatArray
    tracks: IntArray
    odometry: FloatArray
    odometry_stamps_ns: IntArray
    mounting: FloatArray
    upside_down: bool

    def __len__(self) -> int:
        """Return the number of matched scans K."""
        return len(self.stamps_ns)


@final
@dataclass(slots=True)
class LaserMotionEstimator:
    """Processes the scans of one laser; `motion` is available at any time.

    The cost is bounded: beams are thinned to 360 and scans to 20 Hz, and 20,000 such scans are matched.

    Parameters
    ----------
    rate_hz : float
        Scans that come faster are thinned out: at 40 Hz every other one is matched.
    """

    rate_hz: float = 21.0
    _odometry: LaserOdometry = field(default_factory=LaserOdometry)
    _rows: array[float] = field(default_factory=lambda: array("d"))  # pose, share, track, odometry, information
    _stamps: array[int] = field(default_factory=lambda: array("q"))  # of the pose, of the odometry
    _geometry: ScanGeometry | None = None
    _directions: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    _first: ScanGeometry | None = None
    _sensor: str = ""
    _last_ns: int = 0
    _passed_over: bool = True

    def __len__(self) -> int:
        """Return the number of scans matched so far."""
        return len(self._stamps) // 2

    def add(self, measurement: Measurement) -> None:
        """Take the next scan and its odometry."""
        odometry, scan = measurement
        is_early = self._stamps and 0 <= scan.stamp_ns - self._last_ns < 1e9 / self.rate_hz
        if is_early or len(self) >= _MOST_SCANS:
            return
        ends, beams = self._ends(scan)
        if len(ends) < _FEWEST_BEAMS:
            self._passed_over = True
            return
        middle_s = 0.0 if scan.beam_times_s is None else float(scan.beam_times_s[beams].mean())
        stamp_ns = scan.stamp_ns + round(1e9 * middle_s)
        information, share = np.zeros((3, 3)), 0.0
        if self._passed_over:
            self._odometry.begin(stamp_ns, ends)
        else:
            information, share = self._odometry.step(stamp_ns, ends)
        self._passed_over = False
        reported = (math.nan,) * 3 if odometry is None else odometry.pose
        self._rows.extend((*self._odometry.pose, share, self._odometry.track, *reported, *information.ravel()))
        self._stamps.extend((stamp_ns, scan.stamp_ns if odometry is None else odometry.stamp_ns))
        self._last_ns = scan.stamp_ns

    def _ends(self, scan: LaserScan) -> tuple[FloatArray, IntArray]:
        """Return ends (K, 2) of at most 360 beams in the laser's frame, and which beams (K,) they are."""
        if scan.geometry is not self._geometry:
            self._geometry = scan.geometry
            self._first = self._first or scan.geometry
            self._sensor = self._sensor or scan.sensor
            turn = adjoint(planar_mounting(scan.geometry) * [0.0, 0.0, 1.0])[:2, :2]
            self._directions = scan.geometry.directions @ turn
        used = scan.beams(*RANGES_M).indices
        used = used[:: -(-len(used) // _MOST_BEAMS) or 1]
        return self._directions[used] * scan.ranges[used, None], used

    @property
    def motion(self) -> LaserMotion:
        """The motion of the laser so far."""
        rows = np.array(self._rows, np.float64).reshape(-1, 17)
        stamps = np.array(self._stamps, np.int64).reshape(-1, 2)
        geometry = self._first or ScanGeometry(np.zeros(0))
        covariances = _covariances(rows[:, 8:].reshape(-1, 3, 3), rows[:, :3], rows[:, 3], len(self._directions))
        return LaserMotion(
            self._sensor,
            stamps[:, 0],
            rows[:, :3],
            covariances,
            rows[:, 3],
            rows[:, 4].astype(np.int64),
            rows[:, 5:8],
            stamps[:, 1],
            planar_mounting(geometry),
            bool(geometry.base_from_laser[2, 2] < 0),
        )


def _covariances(information: FloatArray, poses: FloatArray, shares: FloatArray, beams: int) -> FloatArray:
    """Return covariances (K, 3, 3) in the laser's frame from normal matrices (K, 3, 3) in the track's frame.

    A direction of the position in which the match kept its guess gets 1 m^2. The first pose of a track is certain.
    """
    turn = adjoint(poses * [0.0, 0.0, 1.0])
    local = turn.transpose(0, 2, 1) @ information @ turn
    by_turn = local[:, :2, 2] / np.maximum(local[:, 2, 2], 1e-9)[:, None]
    place = local[:, :2, :2] - local[:, :2, 2, None] * by_turn[:, None]
    strength, directions = np.linalg.eigh(place)
    agreeing = shares * min(beams, _MOST_BEAMS)
    held = strength < MIN_INFORMATION * agreeing[:, None]
    weak = np.where(held, _BEAM_SIGMA_M**2 - strength, 0.0)
    regular = local.copy()
    regular[:, :2, :2] += np.einsum("kij,kj,klj->kil", directions, weak, directions)
    regular[:, 2, 2] = np.maximum(regular[:, 2, 2], 1e-6)
    regular += 1e-9 * np.eye(3)
    floor = np.diag([_FLOOR_M**2, _FLOOR_M**2, _FLOOR_RAD**2])
    matched = (shares > 0)[:, None, None]
    return np.asarray(matched * _BEAM_SIGMA_M**2 * np.linalg.inv(regular) + floor, dtype=np.float64)
