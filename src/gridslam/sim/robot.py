"""A simulated differential-drive robot: the path that it drives along a route, and its odometry."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry import se2
from gridslam.geometry.angles import wrap
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, IntArray

_STEP_M = 0.01  # speed is planned at this spacing along the path
_SPOT_TURN_RAD = 2.2  # a sharper corner is turned on the spot


@final
@parameters(frozen=True)
class RobotConfig:
    """Limits of a differential-drive robot; the defaults are a calm indoor robot.

    Parameters
    ----------
    v_max_m_s : float, m/s, > 0
        Greatest speed.
    omega_max_rad_s : float, rad/s, > 0
        Greatest turn rate.
    acceleration_m_s2 : float, m/s^2, > 0
        Of speeding up and of braking; for turns on the spot in proportion, so that both limits take equally long.
    turning_radius_m : float, m, > 0
        Radius of the arc that rounds a corner of the route, where its legs are long enough.
    radius_m : float, m, >= 0
        Of the robot's body: it must pass every wall.
    backs_out : bool
        Whether it leaves a dead end backward, and drives so until the next one, instead of turning on the spot.
    """

    v_max_m_s: float = bounded(0.6, gt=0)
    omega_max_rad_s: float = bounded(1.0, gt=0)
    acceleration_m_s2: float = bounded(0.6, gt=0)
    turning_radius_m: float = bounded(0.5, gt=0)
    radius_m: float = bounded(0.22, ge=0)
    backs_out: bool = False


@final
@parameters(frozen=True)
class OdometryNoise:
    """Systematic and random error of wheel odometry.

    Random error is a random walk: its variances grow with the metres and radians moved, so they do not depend on
    how many readings a path is cut into. The defaults lose some 20 degrees in 100 m; the Intel log's odometry loses 30.

    Parameters
    ----------
    distance_scale, turn_scale : float
        Measured over true distance, and turn.
    bias_rad_per_m : float, rad/m
        Turn measured for each metre driven (wheels of unequal diameter).
    alpha1 : float, rad^2/rad, >= 0
        Variance of the heading per rotation.
    alpha2 : float, rad^2/m, >= 0
        Variance of the heading per translation.
    alpha3 : float, m^2/m, >= 0
        Variance of the distance per translation.
    alpha4 : float, m^2/rad, >= 0
        Variance of the distance per rotation.

    Notes
    -----
    The four alphas mean what they mean in the odometry motion model of Probabilistic Robotics, Table 5.6, where
    variances grow with the square of the motion and therefore belong to one length of step.
    """

    distance_scale: float = 1.01
    turn_scale: float = 0.99
    bias_rad_per_m: float = 0.0015
    alpha1: float = bounded(2e-4, ge=0)
    alpha2: float = bounded(1e-4, ge=0)
    alpha3: float = bounded(2e-4, ge=0)
    alpha4: float = bounded(1e-4, ge=0)


class _Piece(NamedTuple):
    """A stretch of the path with constant twist: straight, arc or turn on the spot."""

    twist: tuple[float, float, float]
    length_m: float  # driven by the outer limit: a turn on the spot counts v_max / omega_max metres a radian
    v_max_m_s: float
    leg: int


@final
class Drive:
    """A robot that follows the waypoints `route` (K, 2) in m from end to end, and where it is at any time.

    It heads for the second waypoint at the start, rounds corners with arcs and turns sharp ones on the spot; speed is
    the greatest that the limits of the robot allow, from rest to rest.

    Attributes
    ----------
    duration_s : float
    """

    def __init__(self, route: FloatArray, robot: RobotConfig) -> None:
        """Plan the way and the speed along it."""
        pieces = _pieces(route, robot)
        starts = [np.array([*route[0], math.atan2(*(route[1] - route[0])[::-1])])]
        for piece in pieces[:-1]:
            starts.append(se2.compose(starts[-1], se2.exp(piece.twist)))
        self._starts = np.array(starts)
        self._begins = np.concatenate([[0.0], np.cumsum([piece.length_m for piece in pieces])])
        self._twists = np.array([piece.twist for piece in pieces])
        self._legs = np.array([piece.leg for piece in pieces], np.int64)
        self._nodes, self._speeds = _speeds(pieces, self._begins, robot.acceleration_m_s2)
        steps = 2 * np.diff(self._nodes) / (self._speeds[1:] + self._speeds[:-1])
        self._times = np.concatenate([[0.0], np.cumsum(steps)])
        self.duration_s = float(self._times[-1])

    def at(self, seconds: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return poses (N, 3) at times (N,) from 0 on, and the leg of the route (N,) int64 that each is on.

        Leg k leads from waypoint k to waypoint k + 1, the turn there included. After the end the robot stands.
        """
        at = self._driven(seconds)
        index = np.searchsorted(self._begins[1:-1], at, side="right")
        share = (at - self._begins[index]) / np.diff(self._begins)[index]
        return se2.compose(self._starts[index], se2.exp(self._twists[index] * share[:, None])), self._legs[index]

    def _driven(self, seconds: FloatArray) -> FloatArray:
        """Return metres driven (N,); between nodes on the path the acceleration is constant."""
        node = np.clip(np.searchsorted(self._times, seconds, side="right") - 1, 0, len(self._times) - 2)
        passed = np.minimum(seconds, self.duration_s) - self._times[node]
        gain = (np.diff(self._speeds) / np.diff(self._times))[node]
        driven = self._nodes[node] + (self._speeds[node] + 0.5 * gain * passed) * passed
        return np.asarray(np.minimum(driven, self._nodes[-1]))


def _pieces(route: FloatArray, robot: RobotConfig) -> list[_Piece]:
    legs = np.diff(route, axis=0)
    lengths = np.hypot(legs[:, 0], legs[:, 1])
    turns = wrap(np.diff(np.arctan2(legs[:, 1], legs[:, 0])))
    metres_per_radian = robot.v_max_m_s / robot.omega_max_rad_s
    pieces = []
    cut = 0.0
    direction = 1.0
    for leg, length in enumerate(lengths.tolist()):
        turn = float(turns[leg]) if leg < len(turns) else 0.0
        tangent = 0.0
        if 0.0 < abs(turn) < _SPOT_TURN_RAD:
            room = 0.5 * float(min(length, lengths[leg + 1]))
            tangent = min(robot.turning_radius_m * math.tan(abs(turn) / 2), room)
        straight = length - cut - tangent
        pieces.append(_Piece((direction * straight, 0.0, 0.0), straight, robot.v_max_m_s, leg))
        cut = tangent
        if tangent > 0:
            radius = tangent / math.tan(abs(turn) / 2)
            arc = radius * abs(turn)
            speed = min(robot.v_max_m_s, robot.omega_max_rad_s * radius)
            pieces.append(_Piece((direction * arc, 0.0, turn), arc, speed, leg))
        elif turn:
            if robot.backs_out and abs(turn) >= _SPOT_TURN_RAD:
                direction = -direction
                turn = float(wrap(turn - math.pi))
            pieces.append(_Piece((0.0, 0.0, turn), metres_per_radian * abs(turn), robot.v_max_m_s, leg))
    return [piece for piece in pieces if piece.length_m > 1e-9]


def _speeds(pieces: list[_Piece], begins: FloatArray, acceleration: float) -> tuple[FloatArray, FloatArray]:
    """Nodes along the path in metres, ascending, and the greatest speed that all limits allow there."""
    nodes = []
    limits = []
    before = 0.0
    direction = 0.0
    for piece, begin in zip(pieces, begins[:-1].tolist(), strict=True):
        count = max(2, math.ceil(piece.length_m / _STEP_M))
        nodes.append(begin + piece.length_m * np.arange(count) / count)
        limits.append(np.full(count, piece.v_max_m_s))
        spot = piece.twist[0] == 0.0
        turns_back = direction * piece.twist[0] < 0.0
        limits[-1][0] = 0.0 if spot or turns_back else min(before, piece.v_max_m_s)
        before = 0.0 if spot else piece.v_max_m_s
        direction = piece.twist[0]
    driven = np.append(np.concatenate(nodes), begins[-1])
    square = np.append(np.concatenate(limits), 0.0) ** 2
    ramp = 2 * acceleration * driven
    square = np.minimum.accumulate(square - ramp) + ramp  # speeding up: v^2 grows by 2 a for each metre
    square = np.minimum.accumulate((square + ramp)[::-1])[::-1] - ramp  # braking: the same backward
    return driven, np.sqrt(np.maximum(square, 0.0))


def simulate_odometry(truth: FloatArray, noise: OdometryNoise, rng: np.random.Generator) -> FloatArray:
    """Return poses (N, 3) that odometry reports for true poses (N, 3); the first is the true one."""
    twists = se2.log(se2.between(truth[:-1], truth[1:]))
    distance = np.hypot(twists[:, 0], twists[:, 1])
    turn = np.abs(twists[:, 2])
    scores = rng.standard_normal((2, len(twists)))
    twists[:, :2] *= noise.distance_scale
    twists[:, 0] += scores[0] * np.sqrt(noise.alpha3 * distance + noise.alpha4 * turn)
    twists[:, 2] *= noise.turn_scale
    twists[:, 2] += noise.bias_rad_per_m * distance + scores[1] * np.sqrt(noise.alpha1 * turn + noise.alpha2 * distance)
    poses = np.empty_like(truth)
    poses[0] = truth[0]
    for k, increment in enumerate(se2.exp(twists)):
        poses[k + 1] = se2.compose(poses[k], increment)
    return poses
