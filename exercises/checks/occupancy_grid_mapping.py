"""Checks of exercise 3: occupancy grid mapping."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from gridslam.models import InverseSensorModel

IntArray = NDArray[np.int64]


def ray_is_connected(free: IntArray, start: Sequence[int], end: Sequence[int]) -> None:
    """Cells (n, 2) that a ray frees: from the laser's on, one step of the longer axis each, to just before the end."""
    steps = np.abs(np.subtract(end, start)).max()
    message = "a ray has as many cells as the longer of both differences, whatever their signs"
    assert len(free) == steps, f"{message}: expected {steps} from {start} to {end}, got {len(free)}"
    if steps:
        path = np.concatenate([along(free, start, end), [end]])
        assert path[0].tolist() == list(start), f"the ray begins at {path[0].tolist()}, not at {start}"
        moves = np.diff(path, axis=0)
        assert (np.abs(moves).max(axis=1) == 1).all(), "two cells of the ray are not neighbours"
        assert (moves * np.sign(np.subtract(end, start)) >= 0).all(), "the ray turns back"


def ray_is_straight(free: IntArray, start: Sequence[int], end: Sequence[int]) -> None:
    """Cells lie within half a cell of the line: on the shorter axis 2 |n (cell - start) - i d| <= n."""
    difference = np.subtract(end, start)
    steps = np.abs(difference).max()
    off = np.abs(steps * (along(free, start, end) - start) - np.arange(steps)[:, None] * difference)
    assert (2 * off <= steps).all(), f"from {start} to {end} a cell is more than half a cell off the line"


def along(cells: IntArray, start: Sequence[int], end: Sequence[int]) -> IntArray:
    """Cells in the order in which the ray passes them: by the axis on which it goes further."""
    difference = np.subtract(end, start)
    axis = int(np.argmax(np.abs(difference)))
    return cells[np.argsort(cells[:, axis] * np.sign(difference[axis]), kind="stable")]


def rays(free_cells: Callable[[Sequence[int], Sequence[int]], IntArray]) -> None:
    """`free_cells(start, end)` -> cells (n, 2) = [row, column]: 500 rays in all directions."""
    k = np.arange(7)
    path = np.column_stack([[0, 0, 1, 1, 2, 2, 3], k])
    wrong = {
        "leave out the cell in which the ray ends": np.concatenate([path, [[3, 7]]]),
        "begin with the cell of the laser, and leave out the last one": np.concatenate([path[1:], [[3, 7]]]),
        "begin with the cell of the laser": path[1:],
        "cells are [row, column]: the two are exchanged": path[:, ::-1],
        "take the cell nearest to the line: round to the nearest integer, not down": np.column_stack([3 * k // 7, k]),
        "take the cell nearest to the line: round to the nearest integer, not up": np.column_stack([-(-3 * k // 7), k]),
        "cells begin at `start`: add it": path - [1, 1],
    }
    got = np.asarray(free_cells([1, 1], [4, 8]))
    require(got.ndim == 2 and got.shape[1] == 2, f"cells of a ray: expected shape (n, 2), got {got.shape}")
    require(len(got) < 9, "cells of a ray: one for each step of the longer axis; diagonal neighbours touch")
    expect("cells of a ray, less its start", along(got, [1, 1], [4, 8]) - [1, 1], path, 0, wrong)
    rng = np.random.default_rng(0)
    pairs = rng.integers(-70, 71, (500, 2, 2)).tolist()
    for start, end in [*pairs, [[0, 0], [0, 9]], [[3, 3], [-6, 3]], [[0, 0], [5, 5]], [[2, 1], [2, 1]]]:
        free = np.asarray(free_cells(start, end)).reshape(-1, 2)
        ray_is_connected(free, start, end)
        if start != end:
            ray_is_straight(free, start, end)


def cell_follows_bayes_rule(
    log_odds_after: Callable[[str], float], sensor: InverseSensorModel, measured: str, rounding: float = 1e-12
) -> None:
    """Compare a cell's log-odds after each measurement, h (hit) or m (miss), with Bayes' rule on probabilities.

    `rounding` is the error of storing the log-odds once.
    """
    belief = 0.5
    for n, z in enumerate(measured, 1):
        if_occupied = sensor.true_occupied if z == "h" else sensor.false_free
        if_free = sensor.false_occupied if z == "h" else sensor.true_free
        belief = if_occupied * belief / (if_occupied * belief + if_free * (1 - belief))
        off = abs(log_odds_after(measured[:n]) - math.log(belief / (1 - belief)))
        assert off <= n * rounding + 1e-5, f"after {measured[:n]} log-odds are {off:.3g} off Bayes' rule"


BAYES_CASES = (
    (0.9, 0.7, "hhmhmmmhhmhmhhh"),
    (0.6, 0.95, "mmmmhhmhm"),
    (0.3663, 0.9667, "hmmmmmmmhmh"),
    (0.99, 0.99, "hmhmhmmm"),
)
"""Probabilities that an occupied cell stops a beam and a free one does not, and measurements."""


def binary_bayes_filter(evidence: Callable[[InverseSensorModel, bool], float]) -> None:
    """`evidence(sensor, hit)` -> nats that a hit or a miss adds to the log-odds of a cell (Tables 4.2 and 9.2)."""
    sensor = InverseSensorModel(true_occupied=0.9, false_free=0.1, false_occupied=0.3, true_free=0.7)
    hit, miss = math.log(0.9 / 0.3), math.log(0.1 / 0.7)
    free = "compare with the probability of the same measurement if the cell is free"
    wrong = {
        "the signs are exchanged: a hit raises the log-odds, and a miss lowers them": [-hit, -miss],
        "a hit and a miss are exchanged": [miss, hit],
        "a miss: the probability if the cell is occupied stands in the numerator": [hit, -miss],
        f"a hit: {free}, false_occupied": [math.log(0.9 / 0.1), miss],
        f"{free}": [math.log(0.9 / 0.1), math.log(0.3 / 0.7)],
        f"{free} ": [math.log(0.9), math.log(0.1)],
        "a miss: its probability if the cell is occupied is false_free": [hit, math.log(0.3 / 0.7)],
        "take the logarithm of the ratio": [0.9 / 0.3, 0.1 / 0.7],
        **{
            "the logarithm is the natural one" + " " * k: [hit / by_hit, miss / by_miss]
            for k, (by_hit, by_miss) in enumerate(product((1.0, math.log(2), math.log(10)), repeat=2))
        },
        "a miss is evidence, too: it lowers the log-odds": [hit, 0.0],
    }
    expect(
        "evidence of a hit and of a miss", [evidence(sensor, True), evidence(sensor, False)], [hit, miss], 1e-9, wrong
    )
    for true_occupied, true_free, measured in BAYES_CASES:
        sensor = InverseSensorModel(true_occupied, 1 - true_occupied, 1 - true_free, true_free)

        def after(seen: str, sensor: InverseSensorModel = sensor) -> float:
            return sum(evidence(sensor, z == "h") for z in seen)

        cell_follows_bayes_rule(after, sensor, measured)
