"""Whether one version's results are worse than another's, beyond the noise of their seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError
from gridslam.types import FloatArray

LEAST_PAIRS: Final = 5
"""Fewer pairs cannot show a change: by chance alone all signs agree in 1 of 2^pairs cases, and 1/16 is above 5 %."""

_BLOCK = 500
_SPREAD_FLOOR: Final = 1e-12


@final
@dataclass(frozen=True)
class Change:
    """The change of one figure in one group of pairs.

    Attributes
    ----------
    group, figure : str
        What was measured, on which log.
    pairs : int
        Pairs with a value.
    mean : float
        Mean of the differences, new minus old; of logarithms, so that its exponential is the ratio.
    p_worse, p_better : float, (0, 1]
        Probability of a difference as large in any of the figures and groups, if nothing had changed.
    """

    group: str
    figure: str
    pairs: int
    mean: float
    p_worse: float
    p_better: float


def find_changes(
    differences: Mapping[str, Mapping[str, ArrayLike]],
    rng: np.random.Generator,
    *,
    margins: Mapping[str, float] | None = None,
    together: str | None = None,
    permutations: int = 20_000,
) -> list[Change]:
    """Test differences of pairs, new minus old, for values above a margin, by permutation.

    If nothing has changed, the two values of a pair are exchangeable, and the sign of each difference is random
    whatever its distribution. The statistic of a figure is Student's t of its differences. Its distribution, and that
    of the largest of all figures, follows from random signs of all pairs; those of one pair are the same for all of
    its figures. The probabilities are adjusted step down by the largest statistic, so that the probability of any false
    alarm, over all groups and figures, is at most the level that they are compared with (Westfall, Young,
    *Resampling-based multiple testing*, 1993; Romano, Wolf, *Exact and approximate stepdown methods for multiple
    hypothesis testing*, JASA 2005).

    Parameters
    ----------
    differences : mapping of str to mapping of str to (N,) array
        By group and figure; all figures of a group have the same pairs in the same order. NaN where a pair has none.
    rng : numpy.random.Generator
        For the signs.
    margins : mapping of str to float, optional
        By figure, how much larger the new values may be; 0 where not given. At least 0.
    together : str, optional
        Name of a group of all pairs; left out if not given.
    permutations : int, at least 1
        How often the signs are drawn.

    Returns
    -------
    list of Change
        In the order of the differences; those with fewer than `LEAST_PAIRS` pairs are left out.

    Raises
    ------
    ArgumentError
        A group's figures differ in shape, a difference is infinite, a margin is negative, or there are no permutations.
    """
    if permutations < 1:
        raise ArgumentError("permutations", "a number of at least 1", permutations)
    margins = margins or {}
    for name, margin in margins.items():
        if not 0 <= margin < math.inf:
            raise ArgumentError("margins", f"a number of at least 0 for {name}", margin)
    pairs = _Pairs.make(differences, together)
    if not pairs.names:
        return []
    shift = np.array([margins.get(figure, 0.0) for _, figure in pairs.names])
    worse, better = _adjusted(pairs, shift, rng, permutations)
    return [
        Change(group, figure, int(pairs.known[:, k].sum()), pairs.mean(k), float(worse[k]), float(better[k]))
        for k, (group, figure) in enumerate(pairs.names)
    ]


@final
@dataclass(frozen=True)
class _Pairs:
    """Differences (P, H) of all pairs, 0 where there is none, and which are known, by hypothesis."""

    names: Sequence[tuple[str, str]]
    values: FloatArray
    known: NDArray[np.bool_]

    @classmethod
    def make(cls, differences: Mapping[str, Mapping[str, ArrayLike]], together: str | None) -> _Pairs:
        sizes = {}
        for group, figures in differences.items():
            shapes = {np.shape(values) for values in figures.values()}
            if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
                raise ArgumentError("differences", f"arrays of one length for {group}", sorted(shapes))
            sizes[group] = next(iter(shapes))[0] if shapes else 0
        total = sum(sizes.values())
        columns: dict[tuple[str, str], FloatArray] = {}
        first = 0
        for group, figures in differences.items():
            for figure, values in figures.items():
                names = [(group, figure), *([(together, figure)] if together is not None else [])]
                for name in names:
                    column = columns.setdefault(name, np.full(total, np.nan))
                    column[first : first + sizes[group]] = values
            first += sizes[group]
        tested = {name: column for name, column in columns.items() if np.isfinite(column).sum() >= LEAST_PAIRS}
        if any(np.isinf(column).any() for column in columns.values()):
            raise ArgumentError("differences", "finite numbers, or NaN", "infinity")
        table = np.column_stack(list(tested.values())) if tested else np.zeros((total, 0))
        return cls(list(tested), np.nan_to_num(table), np.isfinite(table))

    def mean(self, k: int) -> float:
        """Mean of the differences of a hypothesis."""
        return float(self.values[self.known[:, k], k].mean())


def _adjusted(
    pairs: _Pairs, shift: FloatArray, rng: np.random.Generator, permutations: int
) -> tuple[FloatArray, FloatArray]:
    """Adjusted probabilities that a figure is larger, and that it is smaller, by chance."""
    sides = []
    for sign in (1.0, -1.0):
        shifted = np.where(pairs.known, sign * pairs.values - shift, 0.0)
        observed = _student(np.ones((1, len(shifted))), shifted, pairs.known)[0]
        order = np.argsort(-observed, kind="stable")
        sides.append((shifted, observed, order, np.zeros(len(order))))
    for first in range(0, permutations, _BLOCK):
        signs = rng.choice([-1.0, 1.0], size=(min(_BLOCK, permutations - first), len(pairs.values)))
        for shifted, observed, order, counts in sides:
            drawn = _student(signs, shifted, pairs.known)[:, order]
            largest = np.maximum.accumulate(drawn[:, ::-1], axis=1)[:, ::-1]  # of this and all less conspicuous ones
            level = observed[order]
            counts += (largest >= level - 1e-9 * np.abs(level)).sum(axis=0)
    found = []
    for _, observed, order, counts in sides:
        probabilities = np.empty(len(observed))
        probabilities[order] = np.maximum.accumulate((1 + counts) / (1 + permutations))
        found.append(probabilities)
    return found[0], found[1]


def _student(signs: FloatArray, values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Student's t (B, H) of the values (P, H) by each set of signs (B, P)."""
    count = known.sum(axis=0)
    mean = signs @ values / count
    squares = (values**2).sum(axis=0)
    variance = np.maximum(squares - count * mean**2, 0.0) / (count - 1)
    return np.asarray(mean / np.sqrt(variance / count + _SPREAD_FLOOR * (squares / count + _SPREAD_FLOOR)))
