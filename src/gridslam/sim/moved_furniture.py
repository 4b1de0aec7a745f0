"""Buildings in which things have moved when the robot comes back, drawn by chance."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gridslam.sim.floor_plan import carve, clearance, furniture, join
from gridslam.sim.routes import wander
from gridslam.sim.world import Change, World
from gridslam.types import FloatArray

__all__ = ["moved_furniture"]

_LANE_M = 0.5  # furniture stays this far from the robot's way
_WALL_M = 0.15
_Area = tuple[float, float, float, float]
_Pieces = FloatArray  # (K, 5): x, y, width, depth in m, heading in rad


class _Plan(NamedTuple):
    """A floor plan with four zones along the route; no zone is visible from the opposite one."""

    spaces: list[_Area]
    zones: list[_Area]
    doors: list[_Pieces]  # of each zone: leaves that shut its doorways, some of them at a time
    sizes: tuple[tuple[float, float], tuple[float, float]]  # of a piece: least and greatest width and depth
    lap: list[tuple[float, float]]  # two waypoints in each zone


def moved_furniture(rng: np.random.Generator) -> World:
    """Draw four rooms around which the robot goes four times, or a ring of corridors, twice.

    While it is in one zone, what stands in the opposite one is moved: each piece for itself or not at all, or, more
    deceptively, all together by the same 0.6 m to 0.9 m. Doors of side rooms are shut and opened.
    """
    plan, laps = (_four_rooms(rng), 4) if rng.random() < 0.5 else (_corridors(rng), 2)
    together = rng.random() < 0.5
    route, places = wander(np.array(plan.lap * laps + plan.lap[:3]), rng)
    lane = _dense(route)
    walls = carve(plan.spaces)
    pieces = [_scattered(zone, plan.sizes, np.empty((0, 5)), lane, rng) for zone in plan.zones]
    leaves = [_some(doors, rng) for doors in plan.doors]

    def standing() -> FloatArray:
        return join(walls, *(furniture(*piece) for zone in [*pieces, *leaves] for piece in zone.tolist()))

    start, changes = standing(), []
    for corner in range(2, 4 * laps):
        zone = (corner - 2) % 4
        pieces[zone] = (_shifted if together else _rearranged)(pieces[zone], plan, zone, lane, rng)
        leaves[zone] = _some(plan.doors[zone], rng)
        changes.append(Change(int(places[2 * corner]), standing()))
    return World.of("moved_furniture", start, route, changes)


def _dense(route: FloatArray) -> FloatArray:
    """Points (N, 2) at most 0.25 m apart along a route."""
    legs = pairwise(route)
    return np.concatenate([np.linspace(a, b, 2 + int(4 * math.dist(a, b))) for a, b in legs])


def _four_rooms(rng: np.random.Generator) -> _Plan:
    """Four rooms of unequal sizes, two by two; the way leads through a doorway in each wall between two of them."""
    (left, right), (low, high) = rng.uniform(7.0, 10.0, 2).tolist(), rng.uniform(6.0, 8.5, 2).tolist()
    west, east, south, north = (float(size * rng.uniform(0.35, 0.65)) for size in (low, high, left, right))
    zones = [(-left, -low, 0, 0), (_WALL_M, -low, right, 0), (_WALL_M, _WALL_M, right, high), (-left, _WALL_M, 0, high)]
    doors = [(0, -west - 0.7, _WALL_M, 0.7 - west), (north - 0.7, 0, north + 0.7, _WALL_M)]
    doors += [(0, east - 0.7, _WALL_M, east + 0.7), (-south - 0.7, 0, 0.7 - south, _WALL_M)]
    lap = [(-south, -west), (-1.0, -west), (north, -west), (north, -1.0)]
    lap += [(north, east), (1.0, east), (-south, east), (-south, 1.0)]
    none = [np.empty((0, 5))] * 4
    return _Plan([*zones, *doors], zones, none, ((0.5, 0.4), (1.8, 0.9)), lap)


def _corridors(rng: np.random.Generator) -> _Plan:
    """A ring of wide corridors with cabinets on their walls, and with closets whose doors are open or shut."""
    width, long, short = (float(size) for size in rng.uniform((2.4, 20.0, 15.0), (2.8, 28.0, 20.0)))
    near, right, top = width / 2, long - width / 2, short - width / 2
    zones = [(width, 0, long, width), (long - width, width, long, short)]
    zones += [(0, short - width, long - width, short), (0, 0, width, short - width)]
    spaces, doors = list(zones), []
    for turn, length in enumerate((long, short, long, short)):
        places = length * rng.uniform((0.2, 0.45, 0.7), (0.3, 0.55, 0.8))
        level = turn % 2 == 0
        wall, out = ((0.0, -1), (long, 1), (short, 1), (0.0, -1))[turn]
        leaves = []
        for at in places.tolist():
            across, deep = wall + out * _WALL_M, wall + out * (_WALL_M + rng.uniform(1.5, 2.5))
            closet, doorway = (at - 0.8, across, at + 0.8, deep), (at - 0.5, wall, at + 0.5, across)
            spaces += [closet, doorway] if level else [_swapped(closet), _swapped(doorway)]
            middle = wall + out * 0.05
            leaves.append((at, middle, 1.0, 0.04, 0.0) if level else (middle, at, 1.0, 0.04, math.pi / 2))
        doors.append(np.array(leaves))
    lap = [(near + 1, near), (right - 1, near), (right, near + 1), (right, top - 1)]
    lap += [(right - 1, top), (near + 1, top), (near, top - 1), (near, near + 1)]
    return _Plan(spaces, zones, doors, ((0.5, 0.25), (1.6, 0.4)), lap)


def _swapped(area: _Area) -> _Area:
    x0, y0, x1, y1 = area
    return y0, x0, y1, x1


def _some(doors: _Pieces, rng: np.random.Generator) -> _Pieces:
    return doors[rng.random(len(doors)) < 0.5]


def _scattered(
    zone: _Area, sizes: tuple[tuple[float, float], tuple[float, float]], kept: _Pieces, lane: FloatArray,
    rng: np.random.Generator,
) -> _Pieces:  # fmt: skip
    """Add pieces to those that are kept, until there is one for each 8 m2 or no room is found for it."""
    x0, y0, x1, y1 = zone
    pieces = kept
    for _ in range(400):
        if len(pieces) >= abs((x1 - x0) * (y1 - y0)) / 8:
            break
        x, y, heading = rng.uniform((x0 + 0.2, y0 + 0.2, 0.0), (x1 - 0.2, y1 - 0.2, math.pi))
        square = np.round(heading / (math.pi / 2)) * math.pi / 2
        piece = np.array([x, y, *rng.uniform(*sizes), heading if rng.random() < 0.3 else square])
        if _fits(piece, pieces, lane):
            pieces = np.concatenate([pieces, piece[None]])
    return pieces


def _fits(piece: FloatArray, others: _Pieces, lane: FloatArray) -> bool:
    apart = np.hypot(*(others[:, :2] - piece[:2]).T).min(initial=np.inf)
    return bool(apart > 1.3 and clearance(furniture(*piece.tolist()), lane).min() > _LANE_M)


def _rearranged(pieces: _Pieces, plan: _Plan, zone: int, lane: FloatArray, rng: np.random.Generator) -> _Pieces:
    """Leave about half of the pieces where they are, and put others anywhere."""
    return _scattered(plan.zones[zone], plan.sizes, pieces[rng.random(len(pieces)) < 0.5], lane, rng)


def _shifted(pieces: _Pieces, plan: _Plan, zone: int, lane: FloatArray, rng: np.random.Generator) -> _Pieces:
    """Move all pieces by the same way along the zone; those that would stand in the robot's way stay."""
    x0, y0, x1, y1 = plan.zones[zone]
    moved = pieces.copy()
    moved[:, 0 if x1 - x0 > y1 - y0 else 1] += rng.uniform(0.6, 0.9) * rng.choice([-1, 1])
    inside = ((moved[:, :2] > [x0, y0]) & (moved[:, :2] < [x1, y1])).all(axis=1)
    free = np.array([clearance(furniture(*piece), lane).min() > _LANE_M for piece in moved.tolist()], np.bool_)
    return np.where((inside & free)[:, None], moved, pieces)
