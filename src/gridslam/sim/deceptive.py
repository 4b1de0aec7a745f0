"""Symmetric buildings and bare corridors, drawn by chance: places that are not the same look as if they were.

In some drives of each kind the robot revisits places, in others it never does, and any loop closure is false. Drives
are between 100 m and 400 m long.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gridslam.sim.floor_plan import carve
from gridslam.sim.routes import distinct, wander
from gridslam.sim.world import World

__all__ = [
    "BARE_CORRIDORS", "SYMMETRIC", "alleys", "bare_corridors", "bare_loop", "cross", "ring", "serpentine",
    "symmetric", "twins",
]  # fmt: skip

_WALL_M = 0.15
_Space = tuple[float, float, float, float]
_Point = tuple[float, float]


def symmetric(rng: np.random.Generator) -> World:
    """Draw a building that looks the same after a half or a quarter turn: a ring, a cross, or twin rings.

    Every corner, arm or wing has its doubles, and no observation from one distinguishes it from them.
    """
    return SYMMETRIC[rng.integers(len(SYMMETRIC))](rng)


def bare_corridors(rng: np.random.Generator) -> World:
    """Draw long corridors without anything on their walls, 40 m and more, of one width.

    Equal ones side by side, driven one after the other and never twice; a loop whose four corners are alike; or
    dead-end alleys next to each other, into which the robot goes one after the other and in the end into the first
    again.
    """
    return BARE_CORRIDORS[rng.integers(len(BARE_CORRIDORS))](rng)


def _turned(spaces: list[_Space], about: float, quarters: int) -> list[_Space]:
    """Spaces after quarter turns about the point (about, about)."""
    for _ in range(quarters):
        spaces = [(2 * about - y0, x0, 2 * about - y1, x1) for x0, y0, x1, y1 in spaces]
    return spaces


def _side(length: float, width: float, rng: np.random.Generator) -> list[_Space]:
    """One side of a ring of corridors, along the x axis: with open rooms below it and niches above."""
    spaces: list[_Space] = [(0.0, 0.0, length, width)]
    for x in _spread(length - 2 * width, int(rng.integers(1, 4)), rng):
        door, half, depth = width + x, rng.uniform(1.2, 1.6), rng.uniform(2.0, 4.0)
        spaces.append((door - half, -_WALL_M - depth, door + half, -_WALL_M))
        spaces.append((door - 0.5, -_WALL_M, door + 0.5, 0.0))
    for x in _spread(length - 2 * width, int(rng.integers(1, 4)), rng):
        spaces.append((width + x - rng.uniform(0.4, 0.9), width, width + x + 0.5, width + rng.uniform(0.2, 0.5)))
    return spaces


def _spread(length: float, count: int, rng: np.random.Generator) -> list[float]:
    """Places along a wall, one in each of `count` equal parts of it, and not at their ends."""
    part = length / count
    places: list[float] = (part * (np.arange(count) + rng.uniform(0.4, 0.6, count))).tolist()
    return places


def _around(length: float, width: float) -> list[_Point]:
    """Corners of the way around a ring of corridors, the one at the lower right first."""
    near, far = width / 2, length - width / 2
    return [(far, near), (far, far), (near, far), (near, near)]


def ring(rng: np.random.Generator) -> World:
    """Twice around a ring, or along three sides of a larger one: one that it never closes."""
    width, returns = float(rng.uniform(1.9, 2.5)), rng.random() < 0.5
    length = float(rng.uniform(20, 30) if returns else rng.uniform(38, 48))
    side, lap = _side(length, width, rng), _around(length, width)
    spaces = [space for quarters in range(4) for space in _turned(side, length / 2, quarters)]
    middle = (length / 2, width / 2)
    way = [middle, *lap, *lap, middle] if returns else [lap[3], *lap[:2], (2 * width, length - width / 2)]
    return World.of("symmetric", carve(spaces), wander(distinct(way), rng)[0])


def cross(rng: np.random.Generator) -> World:
    """Into each of four equal arms of a hall, and into each once more."""
    hall, arm, width = float(rng.uniform(5, 8)), float(rng.uniform(12, 18)), float(rng.uniform(1.9, 2.5))
    low, high, near, far = -width / 2, width / 2, hall / 2, hall / 2 + arm
    spaces: list[_Space] = [(-near, -near, near, near), (0.0, low, far, high)]
    for x in _spread(arm, int(rng.integers(1, 4)), rng):
        spaces.append((near + x, low - rng.uniform(0.3, 1.0), near + x + rng.uniform(0.8, 1.5), high))
    ends = [(far - 1.2, 0.0), (0.0, far - 1.2), (1.2 - far, 0.0), (0.0, 1.2 - far)]
    way: list[_Point] = [ends[0]]
    for end in [*rng.permutation(4)[1:], *rng.permutation(4)]:
        way += [(0.0, 0.0), ends[end]]
    walls = carve([space for quarters in range(4) for space in _turned(spaces, 0.0, quarters)])
    return World.of("symmetric", walls, wander(distinct(way), rng)[0])


def twins(rng: np.random.Generator) -> World:
    """Around a ring, through a link into the other, which is the first turned by half, and around it; or back too."""
    length, width, link = float(rng.uniform(13, 17)), float(rng.uniform(1.9, 2.5)), float(rng.uniform(12, 18))
    side, half = _side(length, width, rng), length / 2
    ring = [space for quarters in range(4) for space in _turned(side, half, quarters)]
    ring.append((length - width, half - width / 2, length + link / 2, half + width / 2))
    centre = length + link / 2
    spaces = ring + [(2 * centre - x0, length - y0, 2 * centre - x1, length - y1) for x0, y0, x1, y1 in ring]
    door, lap = (length - width / 2, half), _around(length, width)
    once = [door, *lap[1:], lap[0], door]
    twin = [(2 * centre - x, length - y) for x, y in once]
    way = [*once, *twin]
    if rng.random() < 0.5:
        way += [*once[:4]]
    return World.of("symmetric", carve(spaces), wander(distinct(way), rng)[0])


def serpentine(rng: np.random.Generator) -> World:
    """Up one corridor, down the next, up the one after it; no place is passed twice."""
    count, width, length = int(rng.integers(3, 5)), float(rng.uniform(1.8, 2.6)), float(rng.uniform(45, 75))
    pitch = width + float(rng.uniform(0.3, 2.0))
    spaces: list[_Space] = []
    way: list[_Point] = []
    for k in range(count):
        y, ends = k * pitch, [-width / 2, length + width / 2][:: -1 if k % 2 else 1]
        spaces.append((-width, y, length + width, y + width))
        way += [(ends[0], y + width / 2), (ends[1], y + width / 2)]
    for k in range(count - 1):
        x = -width if k % 2 else length
        spaces.append((x, k * pitch, x + width, (k + 1) * pitch + width))
    return World.of("bare_corridors", carve(spaces), wander(distinct(way), rng)[0])


def bare_loop(rng: np.random.Generator) -> World:
    """Once around a bare ring and half around again."""
    width, long, short = float(rng.uniform(1.8, 2.6)), float(rng.uniform(42, 65)), float(rng.uniform(18, 42))
    spaces = [(0.0, 0.0, long, width), (0.0, short - width, long, short)]
    spaces += [(0.0, 0.0, width, short), (long - width, 0.0, long, short)]
    middle, right, top = width / 2, long - width / 2, short - width / 2
    lap = [(right, middle), (right, top), (middle, top), (middle, middle)]
    way = [(long / 3, middle), *lap, *lap[:2], (long / 2, top)]
    return World.of("bare_corridors", carve(spaces), wander(distinct(way), rng)[0])


def alleys(rng: np.random.Generator) -> World:
    """Drive into dead-end alleys that lie next to each other, one after the other; one of them twice."""
    count, width, length = 3, float(rng.uniform(1.8, 2.6)), float(rng.uniform(40, 46))
    pitch = width + float(rng.uniform(0.3, 3.0))
    spaces: list[_Space] = [(-2.0, 0.0, (count - 1) * pitch + width + 2.0, width)]
    way: list[_Point] = [(-1.0, width / 2)]
    for k in [*range(count), int(rng.integers(count))]:
        x = k * pitch + width / 2
        spaces.append((x - width / 2, 0.0, x + width / 2, width + length))
        way += [(x, width / 2), (x, width + length - 1.2), (x, width / 2)]
    return World.of("bare_corridors", carve(spaces), wander(distinct(way), rng)[0])


SYMMETRIC: tuple[Callable[[np.random.Generator], World], ...] = (ring, cross, twins)
"""What `symmetric` draws one of."""

BARE_CORRIDORS: tuple[Callable[[np.random.Generator], World], ...] = (serpentine, bare_loop, alleys)
"""What `bare_corridors` draws one of."""
