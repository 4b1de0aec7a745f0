"""A world: a floor plan, the robot's route through it, and changes while it drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.types import FloatArray, IntArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Other walls, (S, 4) float64 in m, that stand from when the robot leaves waypoint number `waypoint` on.

    They replace all that stood before, the floor plan's own included: furniture is moved, doors are opened or shut.
    """

    waypoint: int
    walls: FloatArray


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A floor plan and the way the robot takes through it.

    Attributes
    ----------
    name : str
    walls : (S, 4) float64, m
        Line segments [x0, y0, x1, y1] at the start.
    route : (K, 2) float64, m
        Waypoints, K >= 2.
    changes : tuple of Change
        In the order in which they happen.
    """

    name: str
    walls: FloatArray
    route: FloatArray
    changes: tuple[Change, ...] = ()

    def __repr__(self) -> str:
        """Return one line."""
        metres = float(np.hypot(*np.diff(self.route, axis=0).T).sum())
        return f"World({self.name}: {len(self.walls)} walls, a route of {metres:.0f} m)"

    @classmethod
    def of(cls, name: str, walls: ArrayLike, route: ArrayLike, changes: Sequence[Change] = ()) -> World:
        """Validate and copy.

        Raises
        ------
        ArgumentError
            For wrong shapes, waypoints that are not finite or repeat, or changes that are not at ascending waypoints
            between the first and the last.
        """
        segments = np.array(walls, dtype=np.float64).reshape(-1, 4)
        waypoints = np.array(route, dtype=np.float64)
        if waypoints.ndim != 2 or waypoints.shape[1] != 2 or len(waypoints) < 2:
            raise ArgumentError("route", "shape (K, 2) with K >= 2", waypoints.shape)
        if not (np.isfinite(segments).all() and (np.abs(np.diff(waypoints, axis=0)).sum(axis=1) > 1e-6).all()):
            raise ArgumentError("route", "finite waypoints, no two in a row the same", waypoints.tolist())
        at = [0, *(change.waypoint for change in changes), len(waypoints) - 1]
        if (np.diff(at) <= 0).any():
            raise ArgumentError("changes", f"at ascending waypoints in [1, {at[-1] - 1}]", at[1:-1])
        return cls(name, segments, waypoints, tuple(changes))

    def stretches(self, legs: IntArray, longest: int) -> Iterator[tuple[slice, FloatArray]]:
        """Cut a drive into stretches of at most `longest` poses, with the walls (S, 4) present during each.

        `legs` (N,) is the leg of the route that each pose is on, ascending.
        """
        begins = np.searchsorted(legs, [change.waypoint for change in self.changes]).tolist()
        plans = [self.walls, *(change.walls for change in self.changes)]
        for first, end, walls in zip([0, *begins], [*begins, len(legs)], plans, strict=True):
            for begin in range(first, end, longest):
                yield slice(begin, min(begin + longest, end)), walls


def wander(
    route: FloatArray, rng: np.random.Generator, aside_m: float = 0.12, every_m: float = 5.0
) -> tuple[FloatArray, IntArray]:
    """Let the robot stray from the straight line, as no robot drives along a corridor as if on rails.

    Parameters
    ----------
    route : (K, 2) float64, m
    rng : numpy.random.Generator
    aside_m : float, m
        Greatest distance from the line.
    every_m : float, m
        Least distance between points at which it strays; shorter legs stay straight.

    Returns
    -------
    route : (L, 2) float64, m
        The waypoints, and others between them.
    places : (K,) int64
        Where the waypoints are among them.
    """
    parts = []
    places = [0]
    for start, end in pairwise(route):
        along = end - start
        length = float(np.hypot(*along))
        between = max(0, int(length / every_m) - 1)
        share = np.arange(1, between + 1)[:, None] / (between + 1)
        aside = rng.uniform(-aside_m, aside_m, (between, 1)) * np.array([-along[1], along[0]]) / length
        parts += [start[None], start + share * along + aside]
        places.append(places[-1] + 1 + between)
    return np.concatenate([*parts, route[-1:]]), np.array(places, np.int64)


def vary_route(world: World, rng: np.random.Generator) -> World:
    """Return the same floor plan with another route, such as that of another day.

    The robot strays from the straight line by other amounts, and drives the route in either direction, unless walls
    change during the drive.

    Parameters
    ----------
    world : World
    rng : numpy.random.Generator

    Returns
    -------
    World
    """
    backward = not world.changes and rng.random() < 0.5
    route, places = wander(world.route[::-1] if backward else world.route, rng, every_m=2.0)
    changes = [Change(int(places[change.waypoint]), change.walls) for change in world.changes]
    return World.of(world.name, world.walls, route, changes)
