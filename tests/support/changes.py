"""Changes of arrays and of JSON, at random: what somebody would write who knows the format."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

INTEGERS = (0, -1, 1, 2, 7, 255, 1000, 10**6, 2**31 - 1, -(2**31), 2**62)
FLOATS = (math.nan, math.inf, -math.inf, 1e308, -1e30, 1e15, 1e9, 1e6, 1e-300, 0.0, -1.0)
_TYPES = (np.float32, np.float64, np.int64, np.int32, np.int16, np.uint8, np.bool_, np.complex128)
_VALUES: tuple[Any, ...] = (None, True, -1, 0, 999, 10**30, 1e308, -1e12, "", "x", "nan", [], [1], {}, [[]], {"a": 5})


def choose(rng: np.random.Generator, items: Any) -> Any:
    """One of some items."""
    return items[int(rng.integers(len(items)))]


def change_json(document: Any, rng: np.random.Generator) -> Any:
    """Replace a value somewhere in a document."""
    here = document
    while True:
        place = choose(rng, list(here) if isinstance(here, dict) else range(len(here)))
        below = here[place]
        if not (isinstance(below, dict | list) and below) or not rng.integers(5):
            here[place] = choose(rng, _VALUES)
            return document
        here = below


def change_array(arrays: dict[str, Any], rng: np.random.Generator) -> None:
    """Change an array's type, shape or one of its numbers, or leave it out."""
    name = choose(rng, sorted(arrays))
    values = np.array(arrays[name])
    match rng.integers(7):
        case 0:
            del arrays[name]
        case 1 if values.dtype.kind in "iufb":
            with np.errstate(all="ignore"):
                arrays[name] = values.astype(_TYPES[rng.integers(len(_TYPES))])
        case 2:
            arrays[name] = [values.reshape(-1), values[None], values.T, values[..., None]][rng.integers(4)]
        case 3:
            arrays[name] = np.zeros([(0,), (3,), (2, 3), ()][rng.integers(4)], values.dtype)
        case 4:
            arrays[name] = np.repeat(values, 2, axis=0) if values.ndim else np.array([values])
        case _ if values.size and values.dtype.kind == "f":
            values.flat[rng.integers(values.size)] = FLOATS[rng.integers(len(FLOATS))]
            arrays[name] = values
        case _ if values.dtype.kind == "U":
            arrays[name] = np.array(str(values.reshape(-1)[0])[:-1]) if values.size else values
