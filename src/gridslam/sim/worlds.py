"""Named worlds: a floor plan and a route through it. Lengths in m; the corner at the lower left is about (0, 0)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from gridslam.arguments import require_generator
from gridslam.errors import ArgumentError
from gridslam.sim.deceptive import bare_corridors, symmetric
from gridslam.sim.equal_rooms import equal_rooms
from gridslam.sim.floor_plan import box, furniture, join, pillar, polyline, room, wall
from gridslam.sim.large import campus, fleet
from gridslam.sim.moved_furniture import moved_furniture
from gridslam.sim.random_building import random_building
from gridslam.sim.world import World
from gridslam.types import FloatArray

__all__ = ["DRAWN_WORLDS", "WORLDS", "corridor", "demo", "hall", "loop", "make_world", "rooms"]


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
    """Points of a bay window: an arc of 100 degrees that bulges to the east, its chord on x."""
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
    south, deep = wall((0, 0), (40, 0), niches), [box(x - w / 2, -0.7, x + w / 2, -0.06) for x, w in niches]
    north = wall((0, 2.2), (40, 2.2), [(6.0, 1.0), (17.5, 1.3), (29.0, 0.9)])
    rooms = [box(4.5, 2.26, 7.5, 5.0), box(15.5, 2.26, 19.5, 6.0), box(27.6, 2.26, 30.4, 4.6)]
    doors = join(*(piece[[1, 2, 3]] for piece in rooms), *(piece[[0, 1, 3]] for piece in deep))
    ends = polyline([(0, 0), (0, 2.2)]), polyline([(40, 0), (40, 2.2)])
    return World.of("corridor", join(south, north, doors, *ends), [(1.0, 1.1), (38.8, 1.1), (20.0, 1.1), (1.4, 1.1)])


def _random(rng: np.random.Generator) -> World:
    return World.of("random", *random_building(rng))


WORLDS: Mapping[str, Callable[[], World]] = MappingProxyType(
    {"demo": demo, "loop": loop, "rooms": rooms, "hall": hall, "corridor": corridor}
)
"""The worlds that are always the same, by name."""

DRAWN_WORLDS: Mapping[str, Callable[[np.random.Generator], World]] = MappingProxyType({
    "random": _random, "equal_rooms": equal_rooms, "symmetric": symmetric, "bare_corridors": bare_corridors,
    "moved_furniture": moved_furniture, "campus": campus, "fleet": fleet,
})  # fmt: skip
"""Kinds of worlds of which each seed draws another, by name."""


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
