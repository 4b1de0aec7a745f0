"""A building drawn by chance: rooms of varied sizes on both sides of a corridor that closes a loop."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gridslam.geometry import se2
from gridslam.sim.floor_plan import clearance, furniture, join, place, wall
from gridslam.types import FloatArray

__all__ = ["random_building"]

_ROOM_M = 4.2  # what the width of a room is about
_LANE_M = 0.5  # furniture stays this far from the robot's way
_APART_M = 1.7  # between the middles of two pieces
_VISIT_PROBABILITY = 0.5


class _Row(NamedTuple):
    """Rooms side by side along the x axis: their walls, and the ways into those that are visited."""

    walls: FloatArray
    visits: list[FloatArray]  # (K, 2) each: from the door into the room


def random_building(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw a building: rooms outside of a ring of corridors and inside of it.

    The robot goes around once, visits about half of the rooms, and goes half around again, so that it closes a loop
    and then drives on in what it knows.

    Parameters
    ----------
    rng : numpy.random.Generator

    Returns
    -------
    walls : (S, 4) float64, m
    route : (K, 2) float64, m
    """
    corridor = rng.uniform(1.8, 2.6)
    inside = rng.uniform((8.0, 5.0), (15.0, 9.0))
    width, height = (inside + 2 * corridor).tolist()
    sides = [(0.0, 0.0, 0.0), (width, 0.0, math.pi / 2), (width, height, math.pi), (0.0, height, -math.pi / 2)]
    walls, visits = [_core(corridor, inside, rng)], []
    for side, length in zip(sides, (width, height, width, height), strict=True):
        row = _row(length, rng.uniform(3.5, 6.0), corridor, rng)
        walls.append(place(row.walls, side))
        visits.append([se2.transform_points(side, visit) for visit in row.visits])
    middle = corridor / 2
    right, top = width - middle, height - middle
    corners = np.array([(right, middle), (right, top), (middle, top), (middle, middle)])
    route = [np.array([[middle, height / 2]]), corners[3:]]
    for side_visits, corner in zip(visits, corners, strict=True):
        route += [*side_visits, corner[None]]
    return join(*walls), np.concatenate([*route, corners[:2]])


def _row(length: float, depth: float, corridor: float, rng: np.random.Generator) -> _Row:
    """Rooms of a depth below the x axis from 0 to `length`; the corridor is above it."""
    count = max(1, round(length / _ROOM_M))
    shares = rng.uniform(0.7, 1.3, count)
    edges = length * np.concatenate([[0.0], np.cumsum(shares) / shares.sum()])
    door_widths = rng.uniform(0.9, 1.3, count)
    doors = rng.uniform(edges[:-1] + 0.9, edges[1:] - 0.9)
    openings = list(zip(doors.tolist(), door_widths.tolist(), strict=True))
    walls = [wall((0, 0), (length, 0), openings), wall((0, -depth), (length, -depth))]
    walls += [wall((x, 0), (x, -depth)) for x in edges.tolist()]
    visits = []
    for left, right, door in zip(edges[:-1].tolist(), edges[1:].tolist(), doors.tolist(), strict=True):
        end = (0.5 * (left + right) + rng.uniform(-0.4, 0.4), -depth * rng.uniform(0.4, 0.6))
        way = np.array([(door, corridor / 2), (door, -0.9), end])
        if rng.random() < _VISIT_PROBABILITY:
            visits.append(np.concatenate([way, way[1::-1]]))
        walls += _furnish((left, right), depth, way, rng)
    return _Row(join(*walls), visits)


def _furnish(span: tuple[float, float], depth: float, way: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Up to four pieces of furniture, mostly along the walls, that leave the way free."""
    lane = np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(way)])
    pieces: list[FloatArray] = []
    centres = np.full((1, 2), np.inf)
    for _ in range(rng.integers(1, 5)):
        width, deep = rng.uniform((0.8, 0.5), (2.0, 0.9)).tolist()
        margin = rng.uniform(0.55, 0.9)
        x, y = rng.uniform((span[0] + margin, margin - depth), (span[1] - margin, -margin))
        if rng.random() < 0.6:
            x, y, heading = np.clip(x, span[0] + 1.1, span[1] - 1.1), margin - depth, 0.0
        else:
            heading = float(rng.choice([math.pi / 2, rng.uniform(0, math.pi)]))
        piece = furniture(x, y, width, deep, heading)
        apart = np.hypot(*(centres - [x, y]).T).min()
        if clearance(piece, lane).min() > _LANE_M and apart > _APART_M:
            pieces.append(piece)
            centres = np.concatenate([centres, [[x, y]]])
    return pieces


def _core(corridor: float, inside: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Two rooms inside of the ring, one with a door to the south, one with a door to the north."""
    (x0, y0), (x1, y1) = (corridor, corridor), (corridor + inside).tolist()
    split = inside[0] * rng.uniform(0.35, 0.65)
    south, north = [(0.5 * split, 1.1)], [(0.5 * (split + inside[0]), 1.1)]
    return join(
        wall((x0, y0), (x1, y0), south),
        wall((x0, y1), (x1, y1), north),
        *(wall((x, y0), (x, y1)) for x in (x0, x0 + split, x1)),
    )
