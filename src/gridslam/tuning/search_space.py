"""The parameters that are searched, as points of the unit cube."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.config import PARAMETERS, Configuration, Search, override
from gridslam.config.tables import value_of
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.types import FloatArray

__all__ = ["Dimension", "SearchSpace", "Value"]

Value = float | bool
_DIGITS = 4  # of a value that is tried: finer differences have no effect, and files stay readable


@final
@dataclass(frozen=True, slots=True)
class Dimension:
    """One parameter: short name, where it is searched, and whether it is a switch."""

    name: str
    search: Search
    switch: bool = False

    def value_at(self, share: float) -> Value:
        """Value at a share in [0, 1] of the range."""
        if self.switch:
            return share >= 0.5
        low, high, log = self.search
        value = math.exp(math.log(low) + share * math.log(high / low)) if log else low + share * (high - low)
        return float(f"{value:.{_DIGITS}g}")

    def share_of(self, value: Value) -> float:
        """Share of the range at which a value lies; one outside is at its end."""
        low, high, log = self.search
        share = math.log(max(value, low) / low) / math.log(high / low) if log else (value - low) / (high - low)
        return min(max(share, 0.0), 1.0)


@final
@dataclass(frozen=True, slots=True)
class SearchSpace:
    """The dimensions that a configuration has; those of parts that are of another kind are left out."""

    dimensions: tuple[Dimension, ...]

    @classmethod
    def of(cls, base: Configuration, names: Sequence[str] = ()) -> SearchSpace:
        """All parameters that are tuned and that `base` has, or those of the given names.

        Raises ConfigurationError for a name that is none of them.
        """
        known = {}
        for name, parameter in PARAMETERS.items():
            if parameter.search is None:
                continue
            try:
                value = value_of(base, parameter.path)
            except AttributeError:  # its part is of another kind
                continue
            known[name] = Dimension(name, parameter.search, isinstance(value, bool))
        if unknown := [name for name in names if name not in known]:
            raise ConfigurationError(f"{unknown[0]}: cannot be tuned; expected one of {', '.join(known)}")
        return cls(tuple(known[name] for name in names or known))

    def __len__(self) -> int:
        """Return the number of dimensions."""
        return len(self.dimensions)

    def values_at(self, point: FloatArray) -> dict[str, Value]:
        """Values by short name at a point (D,) of the unit cube."""
        shares = point.tolist()
        return {one.name: one.value_at(share) for one, share in zip(self.dimensions, shares, strict=True)}

    def point_of(self, base: Configuration) -> FloatArray:
        """Point (D,) of the unit cube at, or nearest to, a configuration."""
        values = [value_of(base, PARAMETERS[one.name].path) for one in self.dimensions]
        return np.array([one.share_of(value) for one, value in zip(self.dimensions, values, strict=True)])  # type: ignore[arg-type]

    def apply(self, base: Configuration, values: Mapping[str, Value]) -> Configuration:
        """The configuration with these values; raises ConfigurationError where they do not go together."""
        return override(base, *(f"{name}={str(value).lower()}" for name, value in values.items()))

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Points (count, D) of a Latin hypercube: of each dimension every count-th part is drawn once.

        Raises ArgumentError where `count` is negative. Source: M. McKay, R. Beckman, W. Conover, Technometrics 1979.
        """
        if count < 0:
            raise ArgumentError("count", "at least 0", count)
        strata = np.array([rng.permutation(count) for _ in self.dimensions]).reshape(len(self), count).T
        return (strata + rng.random((count, len(self)))) / max(count, 1)
