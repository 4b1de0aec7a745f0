"""A random generator as text, so that what was begun with it goes on with the same numbers."""

from __future__ import annotations

import json

import numpy as np

from gridslam.errors import ArgumentError

__all__ = ["dump_generator", "load_generator"]

_GENERATORS = {"PCG64": np.random.PCG64, "PCG64DXSM": np.random.PCG64DXSM}
"""Bit generators whose state is plain integers; the first is that of `numpy.random.default_rng`."""


def dump_generator(rng: np.random.Generator) -> str:
    """State of a generator as JSON; raises ArgumentError where it is not plain integers."""
    state = rng.bit_generator.state
    if state["bit_generator"] not in _GENERATORS:
        raise ArgumentError("rng", f"a generator over {' or '.join(_GENERATORS)}", state["bit_generator"])
    return json.dumps(state)


def load_generator(text: str) -> np.random.Generator:
    """Generator that goes on where that of the text was; raises ArgumentError where the text is none."""
    try:
        state = json.loads(text)
        bits = _GENERATORS[state["bit_generator"]]()
        bits.state = state
    except (ValueError, KeyError, TypeError) as error:
        raise ArgumentError("generator", f"the state of {' or '.join(_GENERATORS)} as JSON", error) from None
    return np.random.Generator(bits)
