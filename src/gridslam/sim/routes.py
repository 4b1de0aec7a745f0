"""Routes through drawn worlds: tours of a net of passages, and a hand that is not quite steady."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from gridslam.types import FloatArray, IntArray

__all__ = ["distinct", "route_length", "tour", "wander"]


def distinct(route: Sequence[tuple[float, float]]) -> FloatArray:
    """Waypoints (K, 2) without those that repeat the one before."""
    points = np.array(route, dtype=np.float64)
    keep = np.ones(len(points), np.bool_)
    keep[1:] = np.abs(np.diff(points, axis=0)).sum(axis=1) > 1e-6
    return points[keep]


def route_length(route: FloatArray) -> float:
    """Length in m of the lines through waypoints (K, 2)."""
    return float(np.hypot(*np.diff(route, axis=0).T).sum())


def tour(
    junctions: FloatArray, passages: Sequence[tuple[int, int]], length_m: float, rng: np.random.Generator
) -> FloatArray:
    """Drive about a net of passages for at least `length_m`.

    At each junction the robot takes the passage that it took the fewest times, by chance among equals, and turns back
    only in a dead end. So it sees everything early, and then everything again, by other ways.

    Parameters
    ----------
    junctions : (J, 2) float64, m
        The tour begins at the first.
    passages : sequence of (int, int)
        Which junctions are joined by a straight passage; the first is taken first.
    length_m : float, m
    rng : numpy.random.Generator

    Returns
    -------
    (K, 2) float64, m
    """
    taken = np.zeros(len(passages))
    here, last, way, length = passages[0][0], -1, [junctions[passages[0][0]]], 0.0
    while length < length_m:
        leaving = [k for k, ends in enumerate(passages) if here in ends]
        onward = [k for k in leaving if k != last] or leaving
        last = 0 if last < 0 else min(rng.permutation(onward).tolist(), key=lambda k: taken[k])
        taken[last] += 1
        here = sum(passages[last]) - here
        way.append(junctions[here])
        length += float(np.hypot(*(way[-1] - way[-2])))
    return np.array(way)


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
    parts, places = [], [0]
    for start, end in pairwise(route):
        along = end - start
        length = float(np.hypot(*along))
        between = max(0, int(length / every_m) - 1)
        share = np.arange(1, between + 1)[:, None] / (between + 1)
        aside = rng.uniform(-aside_m, aside_m, (between, 1)) * np.array([-along[1], along[0]]) / length
        parts += [start[None], start + share * along + aside]
        places.append(places[-1] + 1 + between)
    return np.concatenate([*parts, route[-1:]]), np.array(places, np.int64)
