"""Work that can be put aside: long computations of which a live robot's scan waits for one step at a time."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

__all__ = ["Computation", "advance", "run_to_completion"]

T = TypeVar("T")

Computation = Generator[None, None, T]
"""Yields after each of its steps, and returns its result."""


def advance(computation: Computation[T], steps: int) -> T | None:
    """Do so many more steps; returns the result if that was enough, else None (which no result may be)."""
    try:
        for _ in range(steps):
            next(computation)
    except StopIteration as end:
        result: T = end.value
        return result
    return None


def run_to_completion(computation: Computation[T]) -> T:
    """Do all that is left."""
    while True:
        try:
            next(computation)
        except StopIteration as end:
            result: T = end.value
            return result
