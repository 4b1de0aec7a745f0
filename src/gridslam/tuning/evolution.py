"""CMA-ES about the best point of the halving: generations of points, each on the whole logs."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.errors import MissingDependencyError
from gridslam.types import FloatArray

__all__ = ["Evaluated", "evolve", "load_library", "population_of"]

_SIGMA = 0.15
"""First standard deviation, of the width of each range: the halving has found the region."""

_FEWEST = 4


@final
class Evaluated(NamedTuple):
    """A point (D,) of the unit cube and its loss."""

    point: FloatArray
    loss: float


def load_library() -> Any:  # noqa: ANN401
    """Class CMA of the library cmaes; raises MissingDependencyError where it is not installed (extra: tune)."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from cmaes import CMA
    except ImportError:
        raise MissingDependencyError("gridslam tune", "cmaes", "tune") from None
    return CMA


def population_of(dimensions: int, trials: int) -> int:
    """Points of a generation: 4 + 3 ln D, fewer where so few trials are left that there would be under four of them.

    Source: N. Hansen, *The CMA evolution strategy: a tutorial*, 2016, Table 1.
    """
    return max(_FEWEST, min(4 + math.floor(3 * math.log(max(dimensions, 1))), trials // 4))


def evolve(
    start: FloatArray,
    trials: int,
    evaluate: Callable[[FloatArray], list[float]],
    *,
    seed: int,
    goes_on: Callable[[], bool] = lambda: True,
) -> list[Evaluated]:
    """Minimize over the unit cube by CMA-ES; every point that was evaluated, in their order.

    Parameters
    ----------
    start : (D,) float64, [0, 1]
        Mean of the first generation.
    trials : int
        Most points; whole generations are evaluated, and none if there is not one.
    evaluate : callable
        Losses of points (K, D); infinite ones rank last.
    seed : int, >= 0
        The same seed and losses give the same points.
    goes_on : callable
        Asked ahead of each generation.

    Raises
    ------
    MissingDependencyError
        The library cmaes (extra: tune) is not installed.

    References
    ----------
    N. Hansen, A. Ostermeier, *Completely derandomized self-adaptation in evolution strategies*, 2001.
    """
    population = population_of(len(start), trials)
    generations = trials // population
    if not generations or not len(start):
        return []
    cma = load_library()
    # CMA-ES adapts one dimension by no covariance of others: a second, unused one makes it work, too.
    padded = max(len(start), 2)
    bounds = np.tile([0.0, 1.0], (padded, 1))
    mean = np.full(padded, 0.5)
    mean[: len(start)] = start
    search = cma(mean=mean, sigma=_SIGMA, bounds=bounds, seed=seed, population_size=population)
    found = list[Evaluated]()
    for _ in range(generations):
        if not goes_on():
            break
        asked = [search.ask() for _ in range(population)]
        points = np.clip(np.array(asked), 0.0, 1.0)[:, : len(start)]
        losses = evaluate(points)
        found += [Evaluated(point, loss) for point, loss in zip(points, losses, strict=True)]
        worst = max((loss for loss in losses if math.isfinite(loss)), default=0.0)
        search.tell([(x, loss if math.isfinite(loss) else worst + 1.0) for x, loss in zip(asked, losses, strict=True)])
    return found
