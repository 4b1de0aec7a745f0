"""Predict the cost of mapping a log by a model of time and memory that is linear in the work, and fit the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.types import FloatArray

__all__ = ["DEFAULT_COSTS", "FEATURES", "Cost", "CostModel", "Work", "fit_costs"]

FEATURES: Final = ("start", "scans", "key_scans", "key_scans x particles", "area_m2", "area_m2 x particles")
"""Terms of the cost, each with a coefficient of at least 0."""

_AREA_M2 = 63.0
"""Area of the map for the square root of the number of key scans, where it is unknown: longer drives return to places.
The median of the logs that the defaults are fitted to."""


@final
@dataclass(frozen=True)
class Work:
    """The amount of work of a run.

    Attributes
    ----------
    scans, key_scans : float
        Scans of the log, and those of them that update the particles.
    particles : int
        Particles of the filter.
    area_m2 : float, optional
        Area of the map's bounding box, m2; estimated from the key scans if it is unknown.
    """

    scans: float
    key_scans: float
    particles: int
    area_m2: float | None = None

    def features(self) -> FloatArray:
        """Return values (6,) of `FEATURES`."""
        area = _AREA_M2 * math.sqrt(self.key_scans) if self.area_m2 is None else self.area_m2
        return np.array([1.0, self.scans, self.key_scans, self.key_scans * self.particles, area, area * self.particles])


@final
@dataclass(frozen=True)
class Cost:
    """CPU time, s, and peak memory, bytes."""

    cpu_s: float
    memory_bytes: float


@final
@dataclass(frozen=True)
class CostModel:
    """Coefficients (6,) of the features, for CPU time (s) and for peak memory (bytes)."""

    cpu_s: tuple[float, ...]
    memory_bytes: tuple[float, ...]

    def estimate(self, work: Work) -> Cost:
        """Estimate the cost of some work."""
        features = work.features()
        return Cost(float(features @ self.cpu_s), float(features @ self.memory_bytes))


DEFAULT_COSTS: Final = CostModel(
    cpu_s=(0.70, 3.6e-4, 3.3e-3, 4.5e-5, 1.9e-4, 5.7e-6),
    memory_bytes=(113e6, 0.0, 1.85e4, 153.0, 0.0, 399.0),
)
"""Fitted to `gridslam map` of real and simulated logs on one core of a server (benchmarks/results/costs.json)."""


def fit_costs(work: Sequence[Work], costs: Sequence[Cost]) -> CostModel:
    """Fit the coefficients to the costs of runs, by least squares of the relative errors.

    Coefficients are at least 0, so that estimates of larger logs than these cannot become negative (Lawson, Hanson,
    *Solving least squares problems*, 1974, chapter 23).

    Raises
    ------
    ArgumentError
        There are no runs, not as many costs as runs, or a cost is not above 0.
    """
    from scipy.optimize import nnls  # slow to import

    if not work or len(work) != len(costs):
        raise ArgumentError("costs", f"one for each of at least one run, {len(work)}", len(costs))
    features = np.stack([each.features() for each in work])
    fitted = []
    for name in ("cpu_s", "memory_bytes"):
        values = np.array([getattr(cost, name) for cost in costs])
        if not (values > 0).all():
            raise ArgumentError("costs", f"a {name} above 0", values.min())
        scale = np.maximum(features.max(axis=0), 1e-9)
        coefficients, _ = nnls(features / scale / values[:, None], np.ones(len(values)))
        fitted.append(tuple(float(value) for value in coefficients / scale))
    return CostModel(*fitted)
