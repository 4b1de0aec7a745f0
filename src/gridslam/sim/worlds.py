"""Named worlds: a floor plan and a route through it. Lengths in m; the corner at the lower left is about (0, 0)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from gridslam.arguments import require_generator
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.sim.floor_plan import box, clearance, furniture, join, pillar, place, polyline, room, wall
from gridslam.sim.world import World
from gridslam.types import FloatArray

_ROOM_M = 4.2  # what the width of a room is about
_LANE_M = 0.5  # furniture stays this far from the robot's way
_APART_M = 1.7  # between the middles of two pieces
_VISIT_PROBABILITY = 0.5


def demo() -> World:
    """Build a small office, 24 m x 18 m, around a loop of corridors; about 100 m that visit rooms and close loops."""
    outside = polyline(
        [(0, 0), (24, 0), (24, 5), *_bay(24, 9, 3.2), (24, 13), (24, 15.5), (21.5, 18), (0, 18)], closed=True
    )
    south = wall((0, 5), (24, 5), [(2.2, 2.4), (7.2, 1.0), (11.6, 1.0), (16.6, 1.0), (21.6, 1.0)])
    north = wall((4.5, 13), (24, 13), [(2.0, 1.0), (7.6, 1.2), (12.7, 1.0), (17.3, 1.0)])
    between = [wall((x, 0), (x, 5)) for x in (4.6, 9.4, 14, 19)]
    between += [wall((x, 13), (x, 18)) for x in (4.5, 9, 14.5, 19.5)]
    core = room(7, 7, 17, 11, south=[(2.0, 1.1), (7.6, 1.1)], north=[(2.6, 1.1)])
    shaft = join(wall((12.2, 7), (12.2, 11)), box(12.2, 9.6, 14, 11))
    east = wall((19, 5), (19, 13), [(2.0, 1.0), (5.8, 1.6)])
    pillars = join(pillar(4.6, 7, 0.25), pillar(4.6, 11, 0.25), pillar(2.6, 12.7, 0.5, 24), pillar(10.9, 8.1, 0.3))
    tables = _pieces(
        (0.6, 9.0, 0.8, 2.6), (0.45, 15.2, 0.7, 3.0), (2.4, 17.6, 2.4, 0.5), (2.3, 0.9, 1.8, 0.8), (0.4, 2.8, 0.5, 1.8),
        (5.5, 1.2, 0.8, 1.6), (8.6, 0.8, 1.4, 0.7, 0.5), (11.6, 0.7, 2.4, 0.8), (13.4, 3.8, 0.7, 1.3),
        (15.0, 0.8, 1.2, 0.8), (18.2, 2.2, 0.8, 1.8), (21.5, 1.1, 2.0, 0.9, 0.3), (23.5, 3.6, 0.5, 1.4),
        (5.3, 16.8, 0.9, 1.7), (8.2, 17.2, 1.2, 0.7), (11.8, 17.3, 3.2, 0.7), (9.6, 15.0, 0.5, 2.0),
        (15.4, 17.2, 1.4, 0.8), (18.9, 15.0, 0.6, 1.6), (20.2, 17.2, 0.8, 0.8, 0.8), (23.2, 13.7, 1.0, 0.6),
        (24.6, 9.0, 1.1, 2.8), (7.5, 10.2, 0.5, 1.2), (16.4, 10.4, 0.8, 0.8),
    )  # fmt: skip
    route = [
        (2.4, 8.0), (2.6, 10.4), (6.0, 9.0), (6.0, 6.0), (7.2, 6.0), (7.2, 2.4), (7.2, 6.0), (16.6, 6.0), (16.6, 2.6),
        (16.6, 6.0), (18.0, 6.0), (18.0, 10.8), (21.6, 10.8), (21.6, 7.0), (18.0, 7.0), (18.0, 12.0), (17.2, 12.0),
        (17.2, 15.4), (17.2, 12.0), (12.1, 12.0), (12.1, 15.6), (12.1, 12.0), (9.6, 12.0), (9.3, 9.4), (9.0, 6.0),
        (6.0, 6.0), (5.8, 12.0), (6.5, 12.0), (6.5, 15.4), (6.5, 12.0), (3.9, 12.2), (3.2, 15.2), (1.6, 13.8),
        (1.6, 11.0), (2.4, 8.0), (2.2, 6.0), (2.2, 2.6),
    ]  # fmt: skip
    return World.of("demo", join(outside, south, north, *between, core, shaft, east, pillars, tables), route)


def _pieces(*places: tuple[float, ...]) -> FloatArray:
    """Furniture at several places: x, y, width, depth and, where it stands askew, its heading."""
    return join(*(furniture(*place) for place in places))


def _bay(x: float, y: float, half_width: float) -> list[tuple[float, float]]:
    """Return points of a bay window: an arc of 100 degrees that bulges to the east, its chord on x."""
    angles = np.deg2rad(np.linspace(-50, 50, 9))
    radius = half_width / np.sin(angles[-1])
    return [(x + radius * (np.cos(a) - np.cos(angles[-1])), y + radius * np.sin(a)) for a in angles]


def loop() -> World:
    """Build a corridor 2.4 m wide around a block of 18 m x 8 m, with cabinets at unequal distances; twice around."""
    cabinets = join(
        box(5, 0, 6.2, 0.4), box(13, 0, 13.9, 0.3), box(22.4, 4, 22.8, 5.3), box(8, 12.4, 10, 12.8),
        box(18, 12.5, 18.6, 12.8), box(0, 8.5, 0.4, 9.4), box(2.1, 5.6, 2.4, 6.3), box(16, 2.0, 17, 2.4),
        pillar(11.5, 10.6, 0.25),
    )  # fmt: skip
    once = [(1.2, 1.2), (21.6, 1.2), (21.6, 11.6), (1.2, 11.6)]
    walls = join(box(0, 0, 22.8, 12.8), box(2.4, 2.4, 20.4, 10.4), cabinets)
    return World.of("loop", walls, [(1.2, 4.0), *once, *once, (1.2, 4.0)])


def rooms() -> World:
    """Build a suite of 3 x 2 rooms that open into one another; the route visits all and closes the loop."""
    cross = join(
        wall((6, 0), (6, 10), [(2.5, 1.1), (7.4, 1.1)]), wall((11, 0), (11, 10), [(3.0, 1.1), (7.0, 1.1)]),
        wall((0, 5), (17, 5), [(3.5, 1.2), (14.5, 1.2)]),
    )  # fmt: skip
    tables = _pieces(
        (1.0, 0.9, 1.4, 0.8), (5.2, 4.3, 0.9, 0.7), (8.5, 0.6, 2.0, 0.7), (16.2, 1.5, 0.8, 2.0), (12.0, 9.3, 1.4, 0.7),
        (16.0, 8.6, 1.2, 1.2, 0.6), (8.4, 9.4, 2.2, 0.6), (0.8, 8.6, 0.7, 1.8),
    )  # fmt: skip
    pillars = join(pillar(8.5, 4.0, 0.3), pillar(4.4, 9.0, 0.25))
    once = [(3.5, 2.5), (8.5, 2.4), (11.0, 2.9), (14.5, 3.4), (14.5, 7.0), (8.5, 7.2), (3.5, 7.4)]
    return World.of("rooms", join(box(0, 0, 17, 10), cross, tables, pillars), [*once, *once, (3.5, 2.5), (2.0, 3.4)])


def hall() -> World:
    """Build a hall of 36 m x 24 m with two rows of pillars and a few crates; the route crosses it and goes around."""
    pillars = [pillar(x, y, 0.35) for x in (6, 12, 18, 24, 30) for y in (7.5, 16.5)]
    crates = _pieces(
        (2.5, 12, 1.2, 2.4), (15.5, 13, 2.6, 1.2, 0.4), (23, 15, 1.5, 1.5, 0.8), (33.5, 3, 2, 1.2), (35, 18, 0.8, 3),
        (9, 22.8, 4, 1),
    )  # fmt: skip
    lobby = wall((27, 24), (27, 20), [(2.0, 1.6)])
    around = [(3, 4), (32, 4.6), (33, 15.5), (24, 21.2), (4, 20), (5, 14)]
    across = [(9, 12), (18.5, 9.5), (27, 13), (30, 9.5), (21, 4.5), (9, 4)]
    return World.of("hall", join(box(0, 0, 36, 24), *pillars, crates, lobby), [*around, *across, *around[:3]])


def corridor() -> World:
    """Build a straight corridor of 40 m x 2.2 m with niches at unequal distances; the route goes there and back."""
    niches = [(3.0, 1.2), (9.5, 0.9), (13.2, 1.6), (21.0, 1.0), (24.4, 0.9), (33.0, 1.4)]
    south = wall((0, 0), (40, 0), niches)
    deep = [box(x - w / 2, -0.7, x + w / 2, -0.06) for x, w in niches]
    north = wall((0, 2.2), (40, 2.2), [(6.0, 1.0), (17.5, 1.3), (29.0, 0.9)])
    rooms = [box(4.5, 2.26, 7.5, 5.0), box(15.5, 2.26, 19.5, 6.0), box(27.6, 2.26, 30.4, 4.6)]
    doors = join(*(piece[[1, 2, 3]] for piece in rooms), *(piece[[0, 1, 3]] for piece in deep))
    ends = [polyline([(x, 0), (x, 2.2)]) for x in (0, 40)]
    return World.of("corridor", join(south, north, doors, *ends), [(1.0, 1.1), (38.8, 1.1), (20.0, 1.1), (1.4, 1.1)])


def random_building(rng: np.random.Generator) -> World:
    """Draw a building: rooms of varied sizes outside of a ring of corridors and inside of it.

    The robot goes around once, visits about half of the rooms, and goes half around again, so that it closes a loop
    and then drives on in what it knows.
    """
    corridor = rng.uniform(1.8, 2.6)
    inside = rng.uniform((8.0, 5.0), (15.0, 9.0))
    width, height = (inside + 2 * corridor).tolist()
    middle = corridor / 2
    right = width - middle
    top = height - middle
    corners = np.array([(right, middle), (right, top), (middle, top), (middle, middle)])
    sides = [(0.0, 0.0, 0.0), (width, 0.0, math.pi / 2), (width, height, math.pi), (0.0, height, -math.pi / 2)]
    walls = [_core(corridor, inside, rng)]
    route = [np.array([[middle, height / 2]]), corners[3:]]
    for side, length, corner in zip(sides, (width, height, width, height), corners, strict=True):
        rooms, visits = _row(length, rng.uniform(3.5, 6.0), corridor, rng)
        walls.append(place(rooms, side))
        route += [*(se2.transform_points(side, visit) for visit in visits), corner[None]]
    return World.of("random", join(*walls), np.concatenate([*route, corners[:2]]))


def _row(length: float, depth: float, corridor: float, rng: np.random.Generator) -> tuple[FloatArray, list[FloatArray]]:
    """Rooms of a depth below the x axis from 0 to `length`, the corridor above it; and the ways into some of them."""
    count = max(1, round(length / _ROOM_M))
    shares = rng.uniform(0.7, 1.3, count)
    edges = length * np.concatenate([[0.0], np.cumsum(shares) / shares.sum()])
    door_widths = rng.uniform(0.9, 1.3, count)
    doors = rng.uniform(edges[:-1] + 0.9, edges[1:] - 0.9).tolist()
    walls = [wall((0, 0), (length, 0), list(zip(doors, door_widths.tolist(), strict=True)))]
    walls += [wall((0, -depth), (length, -depth)), *(wall((x, 0), (x, -depth)) for x in edges.tolist())]
    visits = []
    for (left, right), door in zip(pairwise(edges.tolist()), doors, strict=True):
        end = (0.5 * (left + right) + rng.uniform(-0.4, 0.4), -depth * rng.uniform(0.4, 0.6))
        way = np.array([(door, corridor / 2), (door, -0.9), end])
        if rng.random() < _VISIT_PROBABILITY:
            visits.append(np.concatenate([way, way[1::-1]]))
        walls += _furnish(left, right, depth, way, rng)
    return join(*walls), visits


def _furnish(left: float, right: float, depth: float, way: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Up to four pieces of furniture, mostly along the walls, that leave the way free."""
    lane = np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(way)])
    pieces: list[FloatArray] = []
    centres = np.full((1, 2), np.inf)
    for _ in range(rng.integers(1, 5)):
        width, deep = rng.uniform((0.8, 0.5), (2.0, 0.9)).tolist()
        margin = rng.uniform(0.55, 0.9)
        x, y = rng.uniform((left + margin, margin - depth), (right - margin, -margin))
        if rng.random() < 0.6:
            x = np.clip(x, left + 1.1, right - 1.1)
            y = margin - depth
            heading = 0.0
        else:
            heading = rng.choice([math.pi / 2, rng.uniform(0, math.pi)])
        piece = furniture(x, y, width, deep, heading)
        apart = np.hypot(*(centres - [x, y]).T).min()
        if clearance(piece, lane).min() > _LANE_M and apart > _APART_M:
            pieces.append(piece)
            centres = np.concatenate([centres, [[x, y]]])
    return pieces


def _core(corridor: float, inside: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return two rooms inside of the ring, one with a door to the south, one with a door to the north."""
    x0 = y0 = corridor
    x1, y1 = (corridor + inside).tolist()
    split = inside[0] * rng.uniform(0.35, 0.65)
    return join(
        wall((x0, y0), (x1, y0), [(0.5 * split, 1.1)]),
        wall((x0, y1), (x1, y1), [(0.5 * (split + inside[0]), 1.1)]),
        *(wall((x, y0), (x, y1)) for x in (x0, x0 + split, x1)),
    )


WORLDS: Mapping[str, Callable[[], World]] = MappingProxyType(
    {"demo": demo, "loop": loop, "rooms": rooms, "hall": hall, "corridor": corridor}
)
"""The worlds that are always the same, by name."""

DRAWN_WORLDS: Mapping[str, Callable[[np.random.Generator], World]] = MappingProxyType(
    {
        "random": random_building,
    }
)
"""Kinds of worlds of which each seed draws another, by name."""


@checked
def make_world(name: str, rng: np.random.Generator) -> World:
    """World of that name, one of `WORLDS`, which do not use `rng`, or of `DRAWN_WORLDS`.

    Raises
    ------
    ArgumentError
        If there is no world of that name.
    """
    require_generator(rng)
    if name in DRAWN_WORLDS:
        return DRAWN_WORLDS[name](rng)
    if name not in WORLDS:
        raise ArgumentError("name", f"one of {', '.join([*WORLDS, *DRAWN_WORLDS])}", repr(name))
    return WORLDS[name]()
