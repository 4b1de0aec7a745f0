"""Checks of arguments: each raises an ArgumentError with the name, the expected and the actual value."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError


@final
class Size(NamedTuple):
    """Annotates an object: its attribute `measure`, or the length of it, is the size `name` of the container."""

    name: str
    measure: str

    def of(self, value: object) -> int:
        """Measure an object."""
        size = getattr(value, self.measure)
        return size if isinstance(size, int) else len(size)


@final
class Limits(NamedTuple):
    """Annotates numbers, or the length of an object: from `low` to `high`, or to the size of that name plus `more`."""

    low: float
    high: float | str
    more: int = 0

    def require(self, name: str, values: NDArray[Any], sizes: Mapping[str, int]) -> None:
        """Refuse values out of the limits."""
        high = sizes[self.high] + self.more if isinstance(self.high, str) else self.high
        wrong = values[~((values >= self.low) & (values <= high))]
        if wrong.size:
            raise ArgumentError(name, f"numbers from {self.low} to {high}", wrong[0])


COUNT = Limits(0, 1 << 62)
"""Range of counts."""
SHARE = Limits(0.0, 1.0)
"""Range of ratios."""


def index_of(size: str) -> Limits:
    """Limit integers to the numbers of the rows of a table, from 0 on."""
    return Limits(0, size, -1)


def freeze(values: ArrayLike, dtype: type, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """Return a read-only copy of `values` with the given dtype and shape (None: any length)."""
    try:
        array: NDArray[Any] = np.array(values, dtype=dtype)
    except (TypeError, ValueError):
        raise ArgumentError(name, f"numbers of shape {shape} (None: any)", describe(values)) from None
    if not _has_shape(array, shape):
        raise ArgumentError(name, f"shape {shape} (None: any)", array.shape)
    array.flags.writeable = False
    return array


def require_array(name: str, array: object, dtype: type, shape: tuple[int | None, ...]) -> None:
    """Check that a value is a NumPy array of exactly this dtype and shape (None: any length); nothing is converted."""
    if isinstance(array, np.ndarray) and array.dtype.type is dtype and array.dtype.isnative and array.shape == shape:
        return  # the way of every scan
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        got = f"one of {array.dtype}" if isinstance(array, np.ndarray) else describe(array)
        raise ArgumentError(name, f"an array of {np.dtype(dtype)}", got)
    if not _has_shape(array, shape):
        raise ArgumentError(name, f"shape {shape}{' (None: any)' if None in shape else ''}", array.shape)


def _has_shape(array: NDArray[Any], shape: tuple[int | None, ...]) -> bool:
    return array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))


def is_covariance(matrix: NDArray[np.float64]) -> bool:
    """Return whether a (3, 3) matrix is finite, symmetric and positive definite, both beyond rounding."""
    if not np.isfinite(matrix).all():
        return False
    scale = np.sqrt(np.abs(np.diagonal(matrix)))
    if not scale.all():
        return False
    correlation = matrix / np.outer(scale, scale)  # of m and rad alike
    symmetric = bool(np.abs(correlation - correlation.T).max() <= 1e-6)
    return symmetric and float(np.linalg.eigvalsh(correlation)[0]) > 1e-9


def require_instance(name: str, value: object, *kinds: type, optional: bool = False) -> None:
    """Refuse a value of none of these classes; None passes where it is `optional`, and no bool as an int."""
    if (optional and value is None) or (isinstance(value, kinds) and not isinstance(value, bool)):
        return
    expected = " or ".join([kind.__name__ for kind in kinds] + ["None"] * optional)
    raise ArgumentError(name, expected, describe(value))


_DEEPEST = 100
_MOST = 10**300
_CONTAINERS = list, tuple, set
_SURROGATE = re.compile("[\ud800-\udfff]")


def require_plain(tree: object, *, odd_names: bool = False) -> None:
    """Check that the lists and dicts of a parser hold only values that programs can use.

    These are lists in lists and dicts in dicts of more than 100 levels, whole numbers beyond 1e300, which neither
    `float` nor `repr` take, and texts with halves of characters, which no file takes; these may be where files of odd
    names are listed.
    """
    level = [tree]
    for _ in range(_DEEPEST):
        for value in level:
            if isinstance(value, int) and abs(value) > _MOST:
                raise ArgumentError("values", "numbers up to 1e300", "a larger one")
            if not odd_names and isinstance(value, str) and not value.isascii() and _SURROGATE.search(value):
                raise ArgumentError("values", "texts of whole characters", ascii(value)[:60])
        parts = ((*value, *value.values()) if isinstance(value, dict) else value for value in level)
        level = [part for below in parts if isinstance(below, _CONTAINERS) for part in below]
        if not level:
            return
    raise ArgumentError("values", f"at most {_DEEPEST} levels of lists and tables", "more")


def require_generator(rng: object) -> None:
    """Check that a value is a random generator, and no seed."""
    if not isinstance(rng, np.random.Generator):
        raise ArgumentError("rng", "a numpy.random.Generator, as numpy.random.default_rng makes it", describe(rng))


def require_seed(seed: object) -> None:
    """Check that a seed is an integer >= 0."""
    _require_least("seed", seed, 0, "a number >= 0")


def require_threads(threads: object) -> None:
    """Check that a number of threads is an integer >= 1."""
    _require_least("threads", threads, 1, "at least one")


def _require_least(name: str, value: object, least: int, expected: str) -> None:
    require_instance(name, value, int, np.integer)
    assert isinstance(value, int | np.integer)
    if value < least:
        raise ArgumentError(name, expected, value)


_LONGEST = 10**40  # beyond some thousand digits an integer has no text


def describe(value: object) -> str:
    """Return a value in a message: itself where it is short, else its class."""
    kind = type(value).__name__
    if isinstance(value, np.ndarray):
        return f"one of {value.dtype} and shape {value.shape}"
    is_long = isinstance(value, int) and abs(value) > _LONGEST
    text = "" if is_long else repr(value)
    return f"{text} ({kind})" if 0 < len(text) <= 40 else f"a {kind}"
