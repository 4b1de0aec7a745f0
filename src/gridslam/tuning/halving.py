"""Successive halving: many configurations on parts of the logs, and the better ones on longer parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar, final

from gridslam.errors import ArgumentError

__all__ = ["REDUCTION", "Rung", "halve", "plan_rungs"]

REDUCTION = 3
"""Factor by which the number of configurations falls, and the part of the logs grows, from rung to rung."""

_SHORTEST_PART = 1 / REDUCTION**2  # of a log: less than a ninth closes no loop

_Candidate = TypeVar("_Candidate")


@final
class Rung(NamedTuple):
    """How many configurations are tried on which part of each log."""

    candidates: int
    part: float


def plan_rungs(candidates: int, shortest_part: float = _SHORTEST_PART) -> list[Rung]:
    """Rungs that begin with `candidates` >= 1 and end with the whole logs; all but the last cost about the same.

    Raises ArgumentError where there is no candidate or the part is not within (0, 1].

    Source: K. Jamieson, A. Talwalkar, *Non-stochastic best arm identification and hyperparameter optimization*, AISTATS
    2016.
    """
    if candidates < 1:
        raise ArgumentError("candidates", "at least 1", candidates)
    if not 0 < shortest_part <= 1:
        raise ArgumentError("shortest_part", "a number in (0, 1]", shortest_part)
    steps = min(
        math.floor(math.log(1 / shortest_part, REDUCTION) + 1e-9),
        math.floor(math.log(candidates, REDUCTION) + 1e-9),
    )
    return [Rung(max(1, candidates // REDUCTION**k), 1 / REDUCTION ** (steps - k)) for k in range(steps + 1)]


def halve(
    candidates: Sequence[_Candidate],
    rungs: Sequence[Rung],
    evaluate: Callable[[Sequence[_Candidate], float], Sequence[float]],
) -> list[tuple[_Candidate, float]]:
    """Evaluate candidates rung by rung; those of the last rung with their losses there, the best first.

    Parameters
    ----------
    candidates : sequence
        Those beyond the first rung's number are left out; where losses are equal the earlier one stays.
    rungs : sequence of Rung
        As `plan_rungs` makes them.
    evaluate : callable
        Gives the losses of some candidates on a part of the logs; infinite where one fails.
    """
    left = list(candidates)[: rungs[0].candidates]
    losses = list[float]()
    for k, rung in enumerate(rungs):
        losses = list(evaluate(left, rung.part))
        order = sorted(range(len(left)), key=losses.__getitem__)
        kept = order if k + 1 == len(rungs) else order[: rungs[k + 1].candidates]
        left, losses = [left[one] for one in kept], [losses[one] for one in kept]
    return list(zip(left, losses, strict=True))
