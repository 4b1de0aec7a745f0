"""Incremental computations: long computations run a few steps per scan."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

__all__ = ["Computation", "advance", "run_to_completion"]

T = TypeVar("T")

Computation = Generator[None, None, T]
"""Yields after each of its steps, and returns its result."""


def advance(computation: Computation[T], steps: int) -> T | None:
    """Run up to `steps` steps; return the result if the computation finished, otherwise None (never a valid result)."""
    try:
        for _ in range(steps):
            next(computation)
    except StopIteration as end:
        result: T = end.value
        return result
    return None


def run_to_completion(computation: Computation[T]) -> T:
    """Run the computation to its end and return the result."""
    while True:
        try:
            next(computation)
        except StopIteration as end:
            result: T = end.value
            return result
