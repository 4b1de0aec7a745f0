"""Large buildings, drawn by chance: a campus of long corridors, and a warehouse to drive about in for hours."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from gridslam.sim.floor_plan import box, carve, clearance, furniture, join
from gridslam.sim.routes import tour, wander
from gridslam.sim.world import World
from gridslam.types import FloatArray

__all__ = ["campus", "fleet"]

_WALL_M = 0.15
_Space = tuple[float, float, float, float]


def campus(rng: np.random.Generator, length_m: float = 2000.0) -> World:
    """Draw a university: a main corridor of 200 m, and side corridors that close rings of 100 m to 400 m with it.

    Niches, shut doors, open rooms and cabinets stand at unequal distances, up to 10 m apart. The robot drives about
    for `length_m`, and passes each place about three times.
    """
    a, b, c, d = rng.uniform((18, 70, 118, 172), (30, 88, 140, 184)).tolist()
    north, south = float(rng.uniform(24, 45)), -float(rng.uniform(25, 50))
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


def _corridor(
    start: FloatArray, end: FloatArray, half: float, rng: np.random.Generator
) -> tuple[list[_Space], list[FloatArray]]:
    """Spaces along a corridor, level or upright, of half width `half`, and cabinets on its walls."""
    length, level = float(np.abs(end - start).sum()), bool(start[1] == end[1])
    x, y = np.minimum(start, end).tolist()

    def at(s0: float, t0: float, s1: float, t1: float) -> _Space:
        near, far = ((s0, t0), (s1, t1)) if level else ((t0, s0), (t1, s1))
        return float(x + near[0]), float(y + near[1]), float(x + far[0]), float(y + far[1])

    spaces, cabinets = [at(-half, -half, length + half, half)], []
    for side in (-1, 1):
        s = float(rng.uniform(3, 8))
        while s < length - 4:
            kind, wide, wall = rng.random(), float(rng.uniform(0.8, 1.2)), side * half
            if kind < 0.15:
                cabinets.append(box(*at(s, wall, s + wide, wall - side * rng.uniform(0.2, 0.4))))
            elif kind < 0.3:
                room = float(rng.uniform(2.6, 4.5))
                spaces.append(at(s, wall, s + wide, wall + side * _WALL_M))
                spaces.append(at(s - 0.8, wall + side * _WALL_M, s + room - 0.8, wall + side * rng.uniform(2.5, 5.0)))
            else:
                spaces.append(at(s, wall, s + wide, wall + side * rng.uniform(0.08, 0.3 if kind < 0.85 else 1.2)))
            s += wide + float(rng.uniform(1.5, 10.0))
    return spaces, cabinets


def fleet(rng: np.random.Generator, length_m: float = 10_000.0) -> World:
    """Draw a warehouse of 100 m x 60 m with nine rows of racks, and stores along its north wall.

    The robot drives about in it for `length_m`, each lap by another way. Best simulated as a stream.
    """
    aisles = np.concatenate([[3.0], 8.0 + 5.5 * np.arange(9) + 2.75]).tolist()
    crossings = [3.0, 50.0, 97.0]
    stores = [10.0 + 16.0 * k + float(rng.uniform(0, 6)) for k in range(5)]
    spaces: list[_Space] = [(0.0, 0.0, 100.0, 60.0)]
    for x in stores:
        spaces += [(x - 0.8, 60.0, x + 0.8, 60.2), (x - 4.0, 60.2, x + 4.0, 60.2 + float(rng.uniform(5, 8)))]
    loads = [load for row in range(9) for load in _rack(8.0 + 5.5 * row, rng)]
    route, _ = wander(tour(*_warehouse_net(aisles, crossings, stores), length_m, rng), rng, aside_m=0.25)
    return World.of("fleet", join(carve(spaces), *loads), route)


def _rack(y: float, rng: np.random.Generator) -> list[FloatArray]:
    """Two racks in a row along the x axis, loaded with pallets of unequal sizes; a few places are empty."""
    loads = []
    for x in [*np.arange(6.0, 46.0, 2.7), *np.arange(53.5, 93.0, 2.7)]:
        if rng.random() < 0.88:
            wide, deep, aside = rng.uniform((1.2, 1.0, -0.15), (2.4, 2.0, 0.15)).tolist()
            loads.append(furniture(x + 1.2, y + aside, wide, deep, float(rng.uniform(-0.05, 0.05))))
    return loads


def _warehouse_net(
    aisles: list[float], crossings: list[float], stores: list[float]
) -> tuple[FloatArray, list[tuple[int, int]]]:
    """Junctions of aisles and crossings; on the last aisle also those of the ways into the stores."""
    junctions = [(x, y) for y in aisles[:-1] for x in crossings]
    across = len(crossings)
    passages = [(k, k + 1) for k in range(len(junctions)) if k % across < across - 1]
    passages += [(k, k + across) for k in range(len(junctions) - across)]
    top, last = len(junctions), aisles[-1] + 0.5
    along = sorted([*crossings, *stores])
    junctions += [(x, last) for x in along] + [(x, 62.5) for x in stores]
    passages += [(top + k, top + k + 1) for k in range(len(along) - 1)]
    passages += [(top - across + k, top + along.index(x)) for k, x in enumerate(crossings)]
    passages += [(top + along.index(x), top + len(along) + k) for k, x in enumerate(stores)]
    return np.array(junctions), passages
