"""Worlds with perceptual aliasing, drawn by chance: places that are not the same look as if they were.

Symmetric buildings, bare corridors and rows of equal rooms; in some drives of each kind the robot revisits places, in
others it never does, and any loop closure is false. And rooms in which things have moved when the robot comes back.
Beside them two large worlds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gridslam.sim.floor_plan import box, clearance, furniture, join, pillar
from gridslam.sim.world import Change, World, wander
from gridslam.sim.worlds import make_world as make_plain_world
from gridslam.types import FloatArray
from passages import carve, tour

_WALL_M = 0.15
_LANE_M = 0.5  # furniture stays this far from the robot's way
_Draw = Callable[[np.random.Generator], World]
_Space = tuple[float, float, float, float]
_Point = tuple[float, float]
_Pieces = FloatArray  # (K, 5): x, y, width, depth in m, heading in rad


def _distinct(route: Sequence[tuple[float, float]]) -> FloatArray:
    """Waypoints (K, 2) without those that repeat the one before."""
    points = np.array(route, dtype=np.float64)
    keep = np.ones(len(points), np.bool_)
    keep[1:] = np.abs(np.diff(points, axis=0)).sum(axis=1) > 1e-6
    return points[keep]


def _world(name: str, spaces: list[_Space], way: list[_Point], rng: np.random.Generator, *desks: FloatArray) -> World:
    return World.of(name, join(carve(spaces), *desks), wander(_distinct(way), rng)[0])


def _turned_four_times(spaces: list[_Space], about: float) -> list[_Space]:
    """Spaces, and the same after one, two and three quarter turns about the point (about, about)."""
    found = list(spaces)
    for _ in range(3):
        spaces = [(2 * about - y0, x0, 2 * about - y1, x1) for x0, y0, x1, y1 in spaces]
        found += spaces
    return found


def _side(length: float, width: float, rng: np.random.Generator) -> list[_Space]:
    """Return one side of a ring of corridors, along the x axis: with open rooms below it and niches above."""
    spaces: list[_Space] = [(0.0, 0.0, length, width)]
    for x in _spread(length - 2 * width, rng):
        door = width + x
        half = rng.uniform(1.2, 1.6)
        spaces.append((door - half, -_WALL_M - rng.uniform(2.0, 4.0), door + half, -_WALL_M))
        spaces.append((door - 0.5, -_WALL_M, door + 0.5, 0.0))
    for x in _spread(length - 2 * width, rng):
        spaces.append((width + x - rng.uniform(0.4, 0.9), width, width + x + 0.5, width + rng.uniform(0.2, 0.5)))
    return spaces


def _spread(length: float, rng: np.random.Generator) -> list[float]:
    """Return places along a wall, one in each of one to three equal parts of it, and not at their ends."""
    count = rng.integers(1, 4)
    return list(length / count * (np.arange(count) + rng.uniform(0.4, 0.6, count)))


def _around(length: float, width: float) -> list[_Point]:
    """Return corners of the way around a ring of corridors, the one at the lower right first."""
    near = width / 2
    far = length - near
    return [(far, near), (far, far), (near, far), (near, near)]


def ring(rng: np.random.Generator) -> World:
    """Twice around a ring, or along three sides of a larger one: one that it never closes."""
    width = rng.uniform(1.9, 2.5)
    returns = rng.random() < 0.5
    length = rng.uniform(20, 30) if returns else rng.uniform(38, 48)
    spaces = _turned_four_times(_side(length, width, rng), length / 2)
    lap = _around(length, width)
    middle = (length / 2, width / 2)
    way = [middle, *lap, *lap, middle] if returns else [lap[3], *lap[:2], (2 * width, length - width / 2)]
    return _world("symmetric", spaces, way, rng)


def cross(rng: np.random.Generator) -> World:
    """Into each of four equal arms of a hall, and into each once more."""
    near = rng.uniform(5, 8) / 2
    arm = rng.uniform(12, 18)
    half = rng.uniform(1.9, 2.5) / 2
    far = near + arm
    spaces: list[_Space] = [(-near, -near, near, near), (0.0, -half, far, half)]
    for x in _spread(arm, rng):
        spaces.append((near + x, -half - rng.uniform(0.3, 1.0), near + x + rng.uniform(0.8, 1.5), half))
    ends = [(far - 1.2, 0.0), (0.0, far - 1.2), (1.2 - far, 0.0), (0.0, 1.2 - far)]
    way = [ends[0]]
    for end in [*rng.permutation(4)[1:], *rng.permutation(4)]:
        way += [(0.0, 0.0), ends[end]]
    return _world("symmetric", _turned_four_times(spaces, 0.0), way, rng)


def twins(rng: np.random.Generator) -> World:
    """Around a ring, through a link into the other, which is the first turned by half, and around it; or back too."""
    length = rng.uniform(13, 17)
    width = rng.uniform(1.9, 2.5)
    link = rng.uniform(12, 18)
    half = length / 2
    centre = length + link / 2
    ring = _turned_four_times(_side(length, width, rng), half)
    ring.append((length - width, half - width / 2, centre, half + width / 2))
    spaces = ring + [(2 * centre - x0, length - y0, 2 * centre - x1, length - y1) for x0, y0, x1, y1 in ring]
    door = (length - width / 2, half)
    lap = _around(length, width)
    once = [door, *lap[1:], lap[0], door]
    way = once + [(2 * centre - x, length - y) for x, y in once]
    if rng.random() < 0.5:
        way += once[:4]
    return _world("symmetric", spaces, way, rng)


def serpentine(rng: np.random.Generator) -> World:
    """Up one corridor, down the next, up the one after it; no place is passed twice."""
    count = int(rng.integers(3, 5))
    width = rng.uniform(1.8, 2.6)
    length = rng.uniform(45, 75)
    pitch = width + rng.uniform(0.3, 2.0)
    spaces: list[_Space] = []
    way: list[_Point] = []
    for k in range(count):
        y = k * pitch
        spaces.append((-width, y, length + width, y + width))
        ends = [(-width / 2, y + width / 2), (length + width / 2, y + width / 2)]
        way += ends[::-1] if k % 2 else ends
    for k in range(count - 1):
        x = -width if k % 2 else length
        spaces.append((x, k * pitch, x + width, (k + 1) * pitch + width))
    return _world("bare_corridors", spaces, way, rng)


def bare_loop(rng: np.random.Generator) -> World:
    """Once around a bare ring and half around again."""
    width = rng.uniform(1.8, 2.6)
    long = rng.uniform(42, 65)
    short = rng.uniform(18, 42)
    spaces = [(0.0, 0.0, long, width), (0.0, short - width, long, short)]
    spaces += [(0.0, 0.0, width, short), (long - width, 0.0, long, short)]
    middle = width / 2
    right = long - middle
    top = short - middle
    lap = [(right, middle), (right, top), (middle, top), (middle, middle)]
    return _world("bare_corridors", spaces, [(long / 3, middle), *lap, *lap[:2], (long / 2, top)], rng)


def alleys(rng: np.random.Generator) -> World:
    """Drive into three dead-end alleys that lie next to each other, one after the other; one of them twice."""
    width = rng.uniform(1.8, 2.6)
    length = rng.uniform(40, 46)
    pitch = width + rng.uniform(0.3, 3.0)
    spaces: list[_Space] = [(-2.0, 0.0, 2 * pitch + width + 2.0, width)]
    way = [(-1.0, width / 2)]
    for k in [0, 1, 2, int(rng.integers(3))]:
        x = k * pitch + width / 2
        spaces.append((x - width / 2, 0.0, x + width / 2, width + length))
        way += [(x, width / 2), (x, width + length - 1.2), (x, width / 2)]
    return _world("bare_corridors", spaces, way, rng)


class _Rooms(NamedTuple):
    """Equal rooms at equal distances along the x axis, room k from k times `pitch` on, each with a door and a desk."""

    pitch: float
    depth: float
    door: float  # of each room's door from its left wall
    door_width: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, least: float, most: float) -> _Rooms:
        pitch = rng.uniform(least, most)
        door = pitch * rng.uniform(0.4, 0.6)
        return cls(pitch, rng.uniform(3.4, 4.6), door, rng.uniform(1.0, 1.2))

    def door_at(self, slot: int) -> float:
        return slot * self.pitch + self.door

    def spaces(self, slots: Iterable[int], y: float, side: int) -> list[_Space]:
        """Return rooms and doorways on one side of a corridor's wall at `y`: above it (1) or below (-1)."""
        found: list[_Space] = []
        near = y + side * _WALL_M
        for slot in slots:
            left = slot * self.pitch + _WALL_M / 2
            door = self.door_at(slot)
            found.append((left, near, (slot + 1) * self.pitch - _WALL_M / 2, y + side * (_WALL_M + self.depth)))
            found.append((door - self.door_width / 2, y, door + self.door_width / 2, near))
        return found

    def desks(self, slots: Iterable[int], y: float, side: int) -> FloatArray:
        """Return a desk in each room, in the same place."""
        near = y + side * (_WALL_M + self.depth - 0.9)
        far = y + side * (_WALL_M + self.depth - 0.2)
        return join(*(box(slot * self.pitch + 0.5, near, slot * self.pitch + 1.9, far) for slot in slots))

    def visit(self, slot: int, middle: float, y: float, side: int) -> list[_Point]:
        """From the middle of a corridor into a room and out of it."""
        x = self.door_at(slot)
        return [(x, middle), (x, y + side * (_WALL_M + 0.5 * self.depth)), (x, middle)]


class _Corridor(NamedTuple):
    """A corridor along the x axis with rooms on both sides, below and above."""

    rooms: _Rooms
    y: float
    width: float
    slots: tuple[list[int], list[int]]

    @property
    def rows(self) -> list[tuple[list[int], float, int]]:
        return [(self.slots[0], self.y, -1), (self.slots[1], self.y + self.width, 1)]

    def visits(self, rng: np.random.Generator, share: float, begin: float, end: float) -> list[_Point]:
        """Ways along the corridor from x = `begin` to x = `end`, into a share of the rooms on both sides."""
        places = [(slot, y, side) for slots, y, side in self.rows for slot in slots if rng.random() < share]
        low, high = sorted((begin, end))
        passed = [place for place in sorted(places) if low < self.rooms.door_at(place[0]) < high]
        middle = self.y + self.width / 2
        ways = [self.rooms.visit(slot, middle, y, side) for slot, y, side in passed[:: 1 if begin < end else -1]]
        return [(begin, middle), *(point for way in ways for point in way), (end, middle)]


def facing_corridors(rng: np.random.Generator) -> World:
    """Draw two parallel corridors that look the same, joined at one end or at both.

    The robot goes down one corridor, into some of the rooms, and comes back through the other. Where they are joined at
    both ends it goes on into the first again, and into other rooms there.
    """
    rooms = _Rooms.drawn(rng, 3.6, 5.0)
    width = rng.uniform(1.9, 2.5)
    returns = rng.random() < 0.6
    slots = list(range(rng.integers(6, 9)))
    length = len(slots) * rooms.pitch
    far = width + 2 * rooms.depth + 3 * _WALL_M
    south = _Corridor(rooms, 0.0, width, (slots, slots))
    north = _Corridor(rooms, far, width, (slots, slots))
    west = -width / 2
    east = length + width / 2
    spaces = _joined(length, far, width)
    route = south.visits(rng, 0.35, west, east) + north.visits(rng, 0.35, east, west)
    if returns:
        spaces.append((-width, 0.0, 0.0, far))
        route += south.visits(rng, 0.35, west, east - width)
    return _with_rooms(south, north, spaces, route, rng)


def long_way_round(rng: np.random.Generator) -> World:
    """Draw a short row of rooms, a long bare corridor behind it, and a long row back.

    Along the bare corridor scan matching is degenerate. The odometry error there, 2 % of 60 m to 75 m, is
    half a room's width or nearly so when it returns through a passage that lies where one of the rooms would be.
    """
    rooms = _Rooms.drawn(rng, 2.6, 3.2)
    width = rng.uniform(1.9, 2.5)
    count = int(rng.integers(6, 9))
    passage = int(rng.integers(2, count - 2))
    total = count + int(rng.uniform(60, 75) / rooms.pitch)
    length = total * rooms.pitch
    far = width + 2 * rooms.depth + 3 * _WALL_M
    x = rooms.door_at(passage)
    behind = list(range(count))
    everywhere = list(range(total))
    south = _Corridor(rooms, 0.0, width, (behind, [slot for slot in behind if slot != passage]))
    north = _Corridor(rooms, far, width, ([slot for slot in everywhere if slot != passage], everywhere))
    west = -width / 2
    east = length + width / 2
    spaces = [*_joined(length, far, width), (x - rooms.door_width / 2, 0.0, x + rooms.door_width / 2, far)]
    end = (count + 2) * rooms.pitch if rng.random() < 0.5 else west
    route = south.visits(rng, 0.3, west, east) + north.visits(rng, 0.1, east, x) + south.visits(rng, 0.5, x, end)
    return _with_rooms(south, north, spaces, route, rng)


def _joined(length: float, far: float, width: float) -> list[_Space]:
    """Return two corridors along the x axis, at 0 and at y = `far`, and one that joins their right ends."""
    corridors = [(-width, y, length + width, y + width) for y in (0.0, far)]
    return [*corridors, (length, 0.0, length + width, far)]


def _with_rooms(
    south: _Corridor, north: _Corridor, spaces: list[_Space], route: list[_Point], rng: np.random.Generator
) -> World:
    rows = [(corridor.rooms, row) for corridor in (south, north) for row in corridor.rows]
    spaces += [space for rooms, row in rows for space in rooms.spaces(*row)]
    return _world("equal_rooms", spaces, route, rng, *(rooms.desks(*row) for rooms, row in rows))


class _Plan(NamedTuple):
    """A floor plan with four zones along the route; no zone is visible from the opposite one."""

    spaces: list[_Space]
    zones: list[_Space]
    doors: list[_Pieces]  # of each zone: leaves that shut its doorways, some of them at a time
    sizes: tuple[tuple[float, float], tuple[float, float]]  # of a piece: least and greatest width and depth
    lap: list[_Point]  # two waypoints in each zone


def moved_furniture(rng: np.random.Generator) -> World:
    """Draw four rooms around which the robot goes four times, or a ring of corridors, twice.

    While it is in one zone, what stands in the opposite one is moved: each piece for itself or not at all, or, more
    deceptively, all together by the same 0.6 m to 0.9 m. Doors of side rooms are shut and opened.
    """
    plan, laps = (_four_rooms(rng), 4) if rng.random() < 0.5 else (_ring_with_closets(rng), 2)
    together = rng.random() < 0.5
    route, places = wander(np.array(plan.lap * laps + plan.lap[:3]), rng)
    lane = np.concatenate([np.linspace(a, b, 2 + int(4 * math.dist(a, b))) for a, b in pairwise(route)])
    walls = carve(plan.spaces)
    pieces = [_scattered(zone, plan.sizes, np.empty((0, 5)), lane, rng) for zone in plan.zones]
    leaves = [_some(doors, rng) for doors in plan.doors]

    def standing() -> FloatArray:
        return join(walls, *(furniture(*piece) for zone in [*pieces, *leaves] for piece in zone.tolist()))

    start = standing()
    changes = []
    for corner in range(2, 4 * laps):
        zone = (corner - 2) % 4
        if together:
            pieces[zone] = _shifted(pieces[zone], plan.zones[zone], lane, rng)
        else:  # about half of the pieces stay, and others are put anywhere
            pieces[zone] = _scattered(plan.zones[zone], plan.sizes, _some(pieces[zone], rng), lane, rng)
        leaves[zone] = _some(plan.doors[zone], rng)
        changes.append(Change(int(places[2 * corner]), standing()))
    return World.of("moved_furniture", start, route, changes)


def _four_rooms(rng: np.random.Generator) -> _Plan:
    """Four rooms of unequal sizes, two by two; the way leads through a doorway in each wall between two of them."""
    left, right = rng.uniform(7.0, 10.0, 2).tolist()
    low, high = rng.uniform(6.0, 8.5, 2).tolist()
    west, east, south, north = (size * rng.uniform(0.35, 0.65) for size in (low, high, left, right))
    zones = [(-left, -low, 0, 0), (_WALL_M, -low, right, 0), (_WALL_M, _WALL_M, right, high), (-left, _WALL_M, 0, high)]
    doors = [(0, -west - 0.7, _WALL_M, 0.7 - west), (north - 0.7, 0, north + 0.7, _WALL_M)]
    doors += [(0, east - 0.7, _WALL_M, east + 0.7), (-south - 0.7, 0, 0.7 - south, _WALL_M)]
    lap = [(-south, -west), (-1.0, -west), (north, -west), (north, -1.0)]
    lap += [(north, east), (1.0, east), (-south, east), (-south, 1.0)]
    return _Plan([*zones, *doors], zones, [np.empty((0, 5))] * 4, ((0.5, 0.4), (1.8, 0.9)), lap)


def _ring_with_closets(rng: np.random.Generator) -> _Plan:
    """Return a ring of wide corridors with cabinets on their walls, and with closets whose doors are open or shut."""
    width, long, short = rng.uniform((2.4, 20.0, 15.0), (2.8, 28.0, 20.0)).tolist()
    near = width / 2
    right = long - width / 2
    top = short - width / 2
    zones = [(width, 0, long, width), (long - width, width, long, short)]
    zones += [(0, short - width, long - width, short), (0, 0, width, short - width)]
    spaces = list(zones)
    doors = []
    for turn, (wall, out, length) in enumerate(((0.0, -1, long), (long, 1, short), (short, 1, long), (0.0, -1, short))):
        leaves = []
        for at in (length * rng.uniform((0.2, 0.45, 0.7), (0.3, 0.55, 0.8))).tolist():
            across = wall + out * _WALL_M
            closet = (at - 0.8, across, at + 0.8, wall + out * (_WALL_M + rng.uniform(1.5, 2.5)))
            doorway = (at - 0.5, wall, at + 0.5, across)
            middle = wall + out * 0.05
            if turn % 2:  # upright: x and y are exchanged
                spaces += [(y0, x0, y1, x1) for x0, y0, x1, y1 in (closet, doorway)]
                leaves.append((middle, at, 1.0, 0.04, math.pi / 2))
            else:
                spaces += [closet, doorway]
                leaves.append((at, middle, 1.0, 0.04, 0.0))
        doors.append(np.array(leaves))
    lap = [(near + 1, near), (right - 1, near), (right, near + 1), (right, top - 1)]
    lap += [(right - 1, top), (near + 1, top), (near, top - 1), (near, near + 1)]
    return _Plan(spaces, zones, doors, ((0.5, 0.25), (1.6, 0.4)), lap)


def _some(pieces: _Pieces, rng: np.random.Generator) -> _Pieces:
    return pieces[rng.random(len(pieces)) < 0.5]


def _scattered(
    zone: _Space,
    sizes: tuple[tuple[float, float], tuple[float, float]],
    kept: _Pieces,
    lane: FloatArray,
    rng: np.random.Generator,
) -> _Pieces:
    """Add pieces to those that are kept, until there is one for each 8 m2 or no room is found for it."""
    x0, y0, x1, y1 = zone
    pieces = kept
    for _ in range(400):
        if len(pieces) >= abs((x1 - x0) * (y1 - y0)) / 8:
            break
        x, y, heading = rng.uniform((x0 + 0.2, y0 + 0.2, 0.0), (x1 - 0.2, y1 - 0.2, math.pi))
        square = np.round(heading / (math.pi / 2)) * math.pi / 2
        piece = np.array([x, y, *rng.uniform(*sizes), heading if rng.random() < 0.3 else square])
        apart = np.hypot(*(pieces[:, :2] - piece[:2]).T).min(initial=np.inf)
        if apart > 1.3 and _leaves_free(piece.tolist(), lane):
            pieces = np.concatenate([pieces, piece[None]])
    return pieces


def _shifted(pieces: _Pieces, zone: _Space, lane: FloatArray, rng: np.random.Generator) -> _Pieces:
    """Move all pieces by the same way along the zone; those that would stand in the robot's way stay."""
    x0, y0, x1, y1 = zone
    moved = pieces.copy()
    moved[:, 0 if x1 - x0 > y1 - y0 else 1] += rng.uniform(0.6, 0.9) * rng.choice([-1, 1])
    inside = ((moved[:, :2] > [x0, y0]) & (moved[:, :2] < [x1, y1])).all(axis=1)
    free = np.array([_leaves_free(piece, lane) for piece in moved.tolist()], np.bool_)
    return np.where((inside & free)[:, None], moved, pieces)


def _leaves_free(piece: list[float], lane: FloatArray) -> bool:
    return bool(clearance(furniture(*piece), lane).min() > _LANE_M)


VARIANTS: Mapping[str, Sequence[_Draw]] = {
    "equal_rooms": (facing_corridors, long_way_round),
    "symmetric": (ring, cross, twins),
    "bare_corridors": (serpentine, bare_loop, alleys),
}
"""Floor plans by kind: equal rooms along two corridors; buildings that look the same after a half or a quarter turn;
corridors of 40 m and more, of one width, without anything on their walls."""


def campus(rng: np.random.Generator, length_m: float = 2000.0) -> World:
    """Draw a university: a main corridor of 200 m, and side corridors that close rings of 100 m to 400 m with it.

    Niches, shut doors, open rooms and cabinets stand at unequal distances, up to 10 m apart. The robot drives about
    for `length_m`, and passes each place about three times.
    """
    a, b, c, d = rng.uniform((18, 70, 118, 172), (30, 88, 140, 184)).tolist()
    north = rng.uniform(24, 45)
    south = -rng.uniform(25, 50)
    main = [(x, 0.0) for x in (0.0, a, b, c, d, 200.0)]
    junctions = np.array([*main, (a, north), (b, north), (c, north), (b, south), (c, south), (d, south)])
    passages = [*pairwise(range(6)), (1, 6), (6, 7), (7, 8), (2, 7), (3, 8)]
    passages += [(2, 9), (3, 10), (4, 11), (9, 10), (10, 11)]
    route, _ = wander(tour(junctions, passages, length_m, rng), rng, aside_m=0.25)
    widths = np.where(np.arange(len(passages)) < 5, rng.uniform(2.8, 3.4), rng.uniform(1.9, 2.5, len(passages)))
    spaces: list[_Space] = []
    cabinets: list[FloatArray] = []
    for (start, end), width in zip(passages, widths.tolist(), strict=True):
        recesses, boxes = _corridor(junctions[start], junctions[end], width / 2, rng)
        spaces += recesses
        cabinets += boxes
    lane = junctions[np.array(passages)].reshape(-1, 4)
    free = [piece for piece in cabinets if clearance(lane, piece.reshape(-1, 2)).min() > 0.65]
    return World.of("campus", join(carve(spaces), *free), route)


def grounds(rng: np.random.Generator) -> World:
    """Draw a site of 200 m x 110 m: streets with yards, trees and cars, and corridors through some of the buildings.

    Two of three passages lie outdoors, 9 m to 16 m wide. The robot drives about for 1 km to 3 km, and passes each of
    them several times, in both directions.
    """
    columns = np.cumsum([0.0, *rng.uniform(45, 75, 3)]).tolist()
    rows = np.cumsum([0.0, *rng.uniform(40, 60, 2)]).tolist()
    junctions = np.array([(x, y) for y in rows for x in columns])
    across = len(columns)
    passages = [(k, k + 1) for k in range(len(junctions)) if k % across < across - 1]
    passages += [(k, k + across) for k in range(len(junctions) - across)]
    route, _ = wander(tour(junctions, passages, rng.uniform(1000, 3000), rng), rng, aside_m=0.25)
    lane = np.concatenate([np.linspace(junctions[start], junctions[end], 200) for start, end in passages])
    spaces: list[_Space] = []
    things: list[FloatArray] = []
    for start, end in passages:
        is_outdoors = rng.random() < 2 / 3
        width = rng.uniform(9, 16) if is_outdoors else rng.uniform(2.2, 3.2)
        recesses, boxes = _corridor(junctions[start], junctions[end], width / 2, rng)
        spaces += recesses
        things += boxes
        for _ in range(int(rng.integers(4, 10)) if is_outdoors else 0):
            along, aside = rng.uniform(), rng.uniform(-width / 2, width / 2)
            x, y = junctions[start] + along * (junctions[end] - junctions[start])
            x, y = (x, y + aside) if junctions[start][1] == junctions[end][1] else (x + aside, y)
            is_tree = rng.random() < 0.6
            things.append(
                pillar(x, y, rng.uniform(0.1, 0.3)) if is_tree else furniture(x, y, 4.3, 1.8, rng.uniform(0, 3))
            )
    free = [thing for thing in things if clearance(thing, lane).min() > 0.65]
    return World.of("grounds", join(carve(spaces), *free), route)


def _corridor(
    start: FloatArray, end: FloatArray, half: float, rng: np.random.Generator
) -> tuple[list[_Space], list[FloatArray]]:
    """Spaces along a corridor, level or upright, of half width `half`, and cabinets on its walls."""
    length = float(np.abs(end - start).sum())
    level = start[1] == end[1]
    x, y = np.minimum(start, end).tolist()

    def at(s0: float, t0: float, s1: float, t1: float) -> _Space:
        return (x + s0, y + t0, x + s1, y + t1) if level else (x + t0, y + s0, x + t1, y + s1)

    spaces = [at(-half, -half, length + half, half)]
    cabinets = []
    for side in (-1, 1):
        s = rng.uniform(3, 8)
        while s < length - 4:
            kind = rng.random()
            wide = rng.uniform(0.8, 1.2)
            wall = side * half
            if kind < 0.15:
                cabinets.append(box(*at(s, wall, s + wide, wall - side * rng.uniform(0.2, 0.4))))
            elif kind < 0.3:
                room = rng.uniform(2.6, 4.5)
                inner = wall + side * _WALL_M
                spaces.append(at(s, wall, s + wide, inner))
                spaces.append(at(s - 0.8, inner, s + room - 0.8, wall + side * rng.uniform(2.5, 5.0)))
            else:
                spaces.append(at(s, wall, s + wide, wall + side * rng.uniform(0.08, 0.3 if kind < 0.85 else 1.2)))
            s += wide + rng.uniform(1.5, 10.0)
    return spaces, cabinets


def _draw(rng: np.random.Generator, plans: Sequence[_Draw]) -> World:
    return plans[rng.integers(len(plans))](rng)


ALIASED: Mapping[str, _Draw] = {
    **{kind: partial(_draw, plans=plans) for kind, plans in VARIANTS.items()},
    "moved_furniture": moved_furniture,
    "campus": campus,
    "grounds": grounds,
}
"""Kinds of worlds of which each seed draws another, by name."""


def make_world(name: str, rng: np.random.Generator) -> World:
    """World of that name: one of `ALIASED`, or of `gridslam.sim`."""
    return ALIASED[name](rng) if name in ALIASED else make_plain_world(name, rng)
