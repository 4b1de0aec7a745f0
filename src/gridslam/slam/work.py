"""Incremental computations: long computations run a few steps per scan."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

__all__ = ["Work", "done", "worked"]

T = TypeVar("T")

Work = Generator[None, None, T]
"""Yields after each of its steps, and returns its result."""


def worked(work: Work[T], steps: int) -> T | None:
    """Run up to `steps` steps; return the result if the computation finished, otherwise None (never a valid result)."""
    try:
        for _ in range(steps):
            next(work)
    except StopIteration as end:
        result: T = end.value
        return result
    return None


def done(work: Work[T]) -> T:
    """Run the computation to its end and return the result."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            result: T = end.value
            return result
