"""Floors made of passages: the walls around free space, and drives about a net of passages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.sim.floor_plan import join
from gridslam.types import FloatArray, IntArray


def carve(spaces: ArrayLike) -> FloatArray:
    """Return walls (S, 4) around free space: the outline of the union of upright rectangles.

    Corridors, rooms, doorways through the thickness of a wall and niches are all rectangles; where they overlap or
    touch, one opens into the other. No wall is there twice, and those in one line are one.

    Of each rectangle (R, 4) two opposite corners, taken to the micrometre, so that adjacent edges touch.
    """
    corners = np.array(spaces, dtype=np.float64)
    corners = np.sort(np.round(corners, 6).reshape(-1, 2, 2), axis=1)
    xs = np.unique(corners[..., 0])
    ys = np.unique(corners[..., 1])
    free = np.zeros((len(ys) + 1, len(xs) + 1), np.bool_)  # cells between the lines, with a border of solid ones
    columns = np.searchsorted(xs, corners[..., 0]) + 1
    rows = np.searchsorted(ys, corners[..., 1]) + 1
    for (left, right), (bottom, top) in zip(columns, rows, strict=True):
        free[bottom:top, left:right] = True
    line, first, last = _runs(free[1:] != free[:-1])
    level = np.stack([xs[first], ys[line], xs[last], ys[line]], axis=1)
    line, first, last = _runs((free[:, 1:] != free[:, :-1]).T)
    upright = np.stack([xs[line], ys[first], xs[line], ys[last]], axis=1)
    return join(level, upright)


def _runs(marked: NDArray[np.bool_]) -> IntArray:
    """Row, first and last line (3, K) of each run of marked cells between lines; the cells at both ends are not."""
    steps = np.diff(marked.astype(np.int8), axis=1)
    row, first = np.nonzero(steps == 1)
    return np.stack([row, first, np.nonzero(steps == -1)[1]])


def tour(
    junctions: FloatArray, passages: Sequence[tuple[int, int]], length_m: float, rng: np.random.Generator
) -> FloatArray:
    """Drive about a net of passages for at least `length_m`.

    At each junction the robot takes the passage that it took the fewest times, by chance among equals, and turns back
    only in a dead end. So it sees everything early, and then everything again, by other ways.

    Some pairs of the junctions (J, 2) are joined by a straight passage; the tour begins at the first of the first.
    """
    taken = np.zeros(len(passages))
    here = passages[0][0]
    last = -1
    way = [junctions[here]]
    length = 0.0
    while length < length_m:
        leaving = [k for k, ends in enumerate(passages) if here in ends]
        onward = [k for k in leaving if k != last] or leaving
        last = 0 if last < 0 else min(rng.permutation(onward).tolist(), key=lambda k: taken[k])
        taken[last] += 1
        here = sum(passages[last]) - here
        way.append(junctions[here])
        length += float(np.hypot(*(way[-1] - way[-2])))
    return np.array(way)
