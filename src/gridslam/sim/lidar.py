"""A simulated planar lidar: exact intersections of its beams with walls and people, then its noise."""

from __future__ import annotations

import math
from typing import Literal, final

import numpy as np

from gridslam.checked import checked
from gridslam.parameters import bounded, parameters
from gridslam.sim.floor_plan import near
from gridslam.types import FloatArray, IntArray

_CHUNK = 1 << 17  # pairs of scan and wall at a time: a few MB of intermediate arrays
_EDGE_RAD = 1e-9  # beams this close to a wall's end still hit it, so that none slips through where two walls meet


@final
@checked
@parameters(frozen=True)
class LidarConfig:
    """A planar lidar, level on the robot. The defaults are those of the laser that recorded the Intel log.

    A scan is taken in an instant unless `scan_time_s` is given; its stamp is the time of its first beam.

    Parameters
    ----------
    beams : int, >= 1
        Beams of a scan.
    field_of_view_rad : float, rad, (0, 2 pi]
        Angle they are spread over, symmetric about the laser's forward axis.
    clockwise : bool
        Whether the beams come from left to right, as given by the bearings of the scans.
    range_max_m : float, m, > 0
        Range from which on there is no return.
    no_return : str
        What is then reported: "max" (`range_max_m`), "inf", or "nan" or "zero", which read as invalid beams.
    sigma_range_m : float, m, >= 0
        Standard deviation of a range; 1 cm is usual for such lasers.
    sigma_range_share : float, >= 0
        What it grows by with each metre of range, as it does where the range is triangulated.
    no_return_probability : float, [0, 1]
        Ratio of beams that are lost (dark or mirroring surfaces).
    x_m, y_m, heading_rad : float
        Mounting: pose of the laser in the robot's base frame.
    rate_hz : float, Hz, > 0
        Scans a second.
    begin_s : float, s, >= 0
        When the first scan is taken.
    scan_time_s : float, s, >= 0
        What a scan takes: beam i of B is measured i / B of it after the stamp, while the robot drives on.
    reports_beam_times : bool
        Whether scans have beam times, if they are not taken in an instant.
    sensor : str
        Name of the laser and of its frame.
    """

    beams: int = bounded(180, ge=1)
    field_of_view_rad: float = bounded(math.pi, gt=0, le=math.tau)
    clockwise: bool = False
    range_max_m: float = bounded(30.0, gt=0)
    no_return: Literal["max", "inf", "nan", "zero"] = "max"
    sigma_range_m: float = bounded(0.01, ge=0)
    sigma_range_share: float = bounded(0.0, ge=0)
    no_return_probability: float = bounded(0.005, ge=0, le=1)
    x_m: float = 0.1
    y_m: float = 0.0
    heading_rad: float = 0.0
    rate_hz: float = bounded(5.0, gt=0)
    begin_s: float = bounded(0.0, ge=0)
    scan_time_s: float = bounded(0.0, ge=0)
    reports_beam_times: bool = True
    sensor: str = "laser"

    @property
    def bearings(self) -> FloatArray:
        """Bearings (beams,) in rad in the order in which they are measured: ascending unless `clockwise`.

        An odd number of beams includes both ends of the field of view, an even number (and a full circle) leaves the
        last one out: the rule by which CARMEN logs, which hold no angles, are read. A single beam looks ahead.
        """
        if self.beams == 1:
            return np.zeros(1)
        whole = self.beams % 2 == 0 or self.field_of_view_rad == math.tau
        step = self.field_of_view_rad / (self.beams if whole else self.beams - 1)
        bearings = -self.field_of_view_rad / 2 + step * np.arange(self.beams, dtype=np.float64)
        return -bearings if self.clockwise else bearings

    def times(self, duration_s: float) -> FloatArray:
        """When scans are taken on a drive of that duration: (N,) float64, s."""
        count = math.floor((duration_s - self.begin_s) * self.rate_hz + 1e-9) + 1
        return self.begin_s + np.arange(count, dtype=np.float64) / self.rate_hz

    @property
    def beam_times_s(self) -> FloatArray:
        """When each beam (beams,) is measured, in s after the stamp."""
        return self.scan_time_s / self.beams * np.arange(self.beams, dtype=np.float64)

    @property
    def mounting(self) -> FloatArray:
        """Pose (3,) of the laser in the robot's base frame."""
        return np.array([self.x_m, self.y_m, self.heading_rad])

    @property
    def reach_m(self) -> float:
        """Range in m beyond which no wall is seen, with eight standard deviations of noise."""
        return self.range_max_m + 8 * (self.sigma_range_m + self.sigma_range_share * self.range_max_m)


def cast_rays(walls: FloatArray, lasers: FloatArray, bearings: FloatArray, reach_m: float = math.inf) -> FloatArray:
    """Return distance along each beam to the first wall.

    Seen from a laser, a wall covers an interval of bearings. Only the beams in it are intersected with the wall,
    some hundredth of all pairs in a building.

    Parameters
    ----------
    walls : (S, 4) float64, m
        Segments. One seen exactly end-on has no width and stops no beam.
    lasers : (N, 3) float64
        Poses of the laser, not on a wall, in the frame of the walls.
    bearings : (B,) float64, rad
        Ascending, within one turn, in the frame of the laser.
    reach_m : float, m
        Walls farther away may be seen or not: those that are far from all the lasers cost nothing.

    Returns
    -------
    (N, B) float64, m
        Infinite where a beam meets nothing.
    """
    ranges = np.full((len(lasers), len(bearings)), np.inf)
    rows = max(1, _CHUNK // max(1, len(walls)))
    for first in range(0, len(lasers), rows):
        some = lasers[first : first + rows]
        _intersect(near(walls, some[:, :2], reach_m), some, bearings, ranges[first : first + rows])
    return ranges


def _intersect(walls: FloatArray, lasers: FloatArray, bearings: FloatArray, ranges: FloatArray) -> None:
    """Lower `ranges` (C, B) to the walls seen from lasers (C, 3)."""
    start = walls[None, :, :2] - lasers[:, None, :2]
    end = walls[None, :, 2:] - lasers[:, None, :2]
    edge = walls[:, 2:] - walls[:, :2]
    start_angle = np.arctan2(start[..., 1], start[..., 0])
    sweep = np.arctan2(end[..., 1], end[..., 0]) - start_angle
    sweep -= math.tau * np.round(sweep / math.tau)
    right_end = start_angle + np.minimum(sweep, 0.0)
    begin = np.mod(right_end - lasers[:, 2:] - bearings[0], math.tau)
    pairs, beam = _covered(begin.ravel(), np.abs(sweep).ravel(), bearings - bearings[0])

    scan, segment = np.divmod(pairs, len(walls))
    angle = lasers[scan, 2] + bearings[beam]
    normal_part = np.cos(angle) * edge[segment, 1] - np.sin(angle) * edge[segment, 0]
    offset = (start[..., 0] * edge[:, 1] - start[..., 1] * edge[:, 0]).ravel()[pairs]
    end_on = np.abs(normal_part) <= _EDGE_RAD * np.hypot(edge[segment, 0], edge[segment, 1])
    reach = offset / np.where(end_on, np.inf, normal_part)
    ahead = reach > 0
    np.minimum.at(ranges, (scan[ahead], beam[ahead]), reach[ahead])


def _covered(begin: FloatArray, width: FloatArray, offsets: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs of interval and beam: which offsets (B,) lie in the intervals [begin, begin + width] (K,) of the circle."""
    stop = begin + width + _EDGE_RAD
    low = np.searchsorted(offsets, begin - _EDGE_RAD)
    high = np.searchsorted(offsets, stop, side="right")
    wrapped = np.searchsorted(offsets, stop - math.tau, side="right")
    interval = np.tile(np.arange(len(begin)), 2)
    first = np.concatenate([low, np.zeros_like(low)])
    count = np.concatenate([high, np.minimum(wrapped, low)])
    count[: len(low)] -= low
    before = np.cumsum(count) - count
    beam = np.arange(count.sum()) - np.repeat(before - first, count)
    return np.repeat(interval, count), beam


def disc_ranges(centres: FloatArray, radius_m: float, lasers: FloatArray, bearings: FloatArray) -> FloatArray:
    """Distance (N, B) in m along each beam to the first of P discs that stand at `centres` (N, P, 2) in each scan.

    Lasers are (N, 1, 3) or, where each beam has a place of its own, (N, B, 3). Infinite where a beam meets none; a disc
    around the laser itself is not seen.
    """
    angles = lasers[..., 2] + bearings
    cos = np.cos(angles)
    sin = np.sin(angles)
    ranges = np.full(angles.shape, np.inf)
    for centre in centres.transpose(1, 2, 0)[..., None]:
        dx = centre[0] - lasers[..., 0]
        dy = centre[1] - lasers[..., 1]
        along = cos * dx + sin * dy
        aside = cos * dy - sin * dx
        depth = np.sqrt(np.maximum(radius_m**2 - aside**2, 0.0))
        hit = (np.abs(aside) < radius_m) & (along > depth)
        np.minimum(ranges, along - depth, out=ranges, where=hit)
    return ranges


def measure(true_ranges: FloatArray, lidar: LidarConfig, rng: np.random.Generator) -> FloatArray:
    """Simulate ranges (N, B) in m as the sensor reports them: with noise, and its value for a beam without return."""
    sigma = lidar.sigma_range_m + lidar.sigma_range_share * np.minimum(true_ranges, lidar.range_max_m)
    noise = sigma * rng.standard_normal(true_ranges.shape)
    lost = rng.random(true_ranges.shape) < lidar.no_return_probability
    measured = np.clip(true_ranges + noise, 1e-3, lidar.range_max_m)
    no_return = {"max": lidar.range_max_m, "inf": np.inf, "nan": np.nan, "zero": 0.0}[lidar.no_return]
    return np.where(lost | (measured >= lidar.range_max_m), no_return, measured)
