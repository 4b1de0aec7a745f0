"""Rows of equal rooms, drawn by chance: one door looks like the next, and one corridor like the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from gridslam.sim.floor_plan import box, carve, join
from gridslam.sim.routes import distinct, wander
from gridslam.sim.world import World
from gridslam.types import FloatArray

__all__ = ["EQUAL_ROOMS", "equal_rooms", "facing_corridors", "long_way_round"]

_WALL_M = 0.15
_Space = tuple[float, float, float, float]
_Point = tuple[float, float]


class _Rooms(NamedTuple):
    """Equal rooms at equal distances along the x axis, room k from k times `pitch` on, each with a door and a desk."""

    pitch: float
    depth: float
    door: float  # of each room's door from its left wall
    door_width: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, least: float, most: float) -> _Rooms:
        pitch = float(rng.uniform(least, most))
        door = pitch * float(rng.uniform(0.4, 0.6))
        return cls(pitch, float(rng.uniform(3.4, 4.6)), door, float(rng.uniform(1.0, 1.2)))

    def door_at(self, slot: int) -> float:
        return slot * self.pitch + self.door

    def spaces(self, slots: Iterable[int], y: float, side: int) -> list[_Space]:
        """Rooms and doorways on one side of a corridor's wall at `y`: above it (1) or below (-1)."""
        found: list[_Space] = []
        near, far, half = y + side * _WALL_M, y + side * (_WALL_M + self.depth), self.door_width / 2
        for slot in slots:
            left, door = slot * self.pitch, self.door_at(slot)
            found.append((left + _WALL_M / 2, near, left + self.pitch - _WALL_M / 2, far))
            found.append((door - half, y, door + half, near))
        return found

    def desks(self, slots: Iterable[int], y: float, side: int) -> FloatArray:
        """A desk in each room, in the same place."""
        near, far = y + side * (_WALL_M + self.depth - 0.9), y + side * (_WALL_M + self.depth - 0.2)
        return join(*(box(slot * self.pitch + 0.5, near, slot * self.pitch + 1.9, far) for slot in slots))

    def visit(self, slot: int, middle: float, y: float, side: int) -> list[_Point]:
        """From the middle of a corridor into a room and out of it."""
        x, inside = self.door_at(slot), y + side * (_WALL_M + 0.5 * self.depth)
        return [(x, middle), (x, inside), (x, middle)]


class _Corridor(NamedTuple):
    """A corridor along the x axis with rooms on both sides, below and above."""

    rooms: _Rooms
    y: float
    width: float
    slots: tuple[list[int], list[int]]

    @property
    def middle(self) -> float:
        return self.y + self.width / 2

    @property
    def rows(self) -> list[tuple[list[int], float, int]]:
        return [(self.slots[0], self.y, -1), (self.slots[1], self.y + self.width, 1)]

    def spaces(self) -> list[_Space]:
        return [space for row in self.rows for space in self.rooms.spaces(*row)]

    def desks(self) -> FloatArray:
        return join(*(self.rooms.desks(*row) for row in self.rows))

    def visits(self, rng: np.random.Generator, share: float, begin: float, end: float) -> list[_Point]:
        """Ways along the corridor from x = `begin` to x = `end`, into a share of the rooms on both sides."""
        places = [(slot, y, side) for slots, y, side in self.rows for slot in slots if rng.random() < share]
        low, high = sorted((begin, end))
        passed = [place for place in sorted(places) if low < self.rooms.door_at(place[0]) < high]
        passed = passed if begin < end else passed[::-1]
        ways = [self.rooms.visit(slot, self.middle, y, side) for slot, y, side in passed]
        return [(begin, self.middle), *(point for way in ways for point in way), (end, self.middle)]


def equal_rooms(rng: np.random.Generator) -> World:
    """Draw a building of equal rooms at equal distances on both sides of two corridors: one of `EQUAL_ROOMS`."""
    return EQUAL_ROOMS[rng.integers(len(EQUAL_ROOMS))](rng)


def facing_corridors(rng: np.random.Generator) -> World:
    """Draw two parallel corridors that look the same, joined at one end or at both.

    The robot goes down one corridor, into some of the rooms, and comes back through the other. Where they are joined at
    both ends it goes on into the first again, and into other rooms there.
    """
    rooms, width, returns = _Rooms.drawn(rng, 3.6, 5.0), float(rng.uniform(1.9, 2.5)), rng.random() < 0.6
    slots = list(range(rng.integers(6, 9)))
    length, far = len(slots) * rooms.pitch, width + 2 * rooms.depth + 3 * _WALL_M
    south, north = (_Corridor(rooms, y, width, (slots, slots)) for y in (0.0, far))
    west, east = -width / 2, length + width / 2
    spaces = [(-width, y, length + width, y + width) for y in (0.0, far)] + [(length, 0.0, length + width, far)]
    route = south.visits(rng, 0.35, west, east) + north.visits(rng, 0.35, east, west)
    if returns:
        spaces.append((-width, 0.0, 0.0, far))
        route += south.visits(rng, 0.35, west, east - width)
    return _built(south, north, spaces, route, rng)


def long_way_round(rng: np.random.Generator) -> World:
    """Draw a short row of rooms, a long bare corridor behind it, and a long row back.

    Along the bare corridor scan matching is degenerate. The odometry error there, 2 % of 60 m to 75 m, is
    half a room's width or nearly so when it returns through a passage that lies where one of the rooms would be.
    """
    rooms, width, count = _Rooms.drawn(rng, 2.6, 3.2), float(rng.uniform(1.9, 2.5)), int(rng.integers(6, 9))
    passage = int(rng.integers(2, count - 2))
    total = count + int(rng.uniform(60, 75) / rooms.pitch)
    length, far, x = total * rooms.pitch, width + 2 * rooms.depth + 3 * _WALL_M, rooms.door_at(passage)
    behind, all_slots = (list(range(number)) for number in (count, total))
    without, all_but = ([slot for slot in slots if slot != passage] for slots in (behind, all_slots))
    south = _Corridor(rooms, 0.0, width, (behind, without))
    north = _Corridor(rooms, far, width, (all_but, all_slots))
    west, east, half = -width / 2, length + width / 2, rooms.door_width / 2
    spaces = [(-width, y, length + width, y + width) for y in (0.0, far)]
    spaces += [(length, 0.0, length + width, far), (x - half, 0.0, x + half, far)]
    end = (count + 2) * rooms.pitch if rng.random() < 0.5 else west
    route = south.visits(rng, 0.3, west, east) + north.visits(rng, 0.1, east, x) + south.visits(rng, 0.5, x, end)
    return _built(south, north, spaces, route, rng)


def _built(
    south: _Corridor, north: _Corridor, spaces: list[_Space], route: list[_Point], rng: np.random.Generator
) -> World:
    walls = join(carve([*spaces, *south.spaces(), *north.spaces()]), south.desks(), north.desks())
    return World.of("equal_rooms", walls, wander(distinct(route), rng)[0])


EQUAL_ROOMS: tuple[Callable[[np.random.Generator], World], ...] = (facing_corridors, long_way_round)
"""What `equal_rooms` draws one of."""
