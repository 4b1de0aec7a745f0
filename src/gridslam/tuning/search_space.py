"""The parameters that are searched, as Optuna's distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

from gridslam.config import PARAMETERS, Configuration, Search, override
from gridslam.config.tables import value_of
from gridslam.errors import ConfigurationError

Value = float | bool
_DIGITS = 4  # of a value that is tried: finer differences have no effect, and files stay readable


@final
@dataclass(frozen=True, slots=True)
class Dimension:
    """One parameter: short name, where it is searched, and whether it is a switch."""

    name: str
    search: Search
    switch: bool = False

    def distribution(self) -> Any:  # noqa: ANN401
        """Return Optuna's distribution of it."""
        import optuna  # an extra

        if self.switch:
            return optuna.distributions.CategoricalDistribution([False, True])
        return optuna.distributions.FloatDistribution(self.search.low, self.search.high, log=self.search.log)

    def round(self, value: Value) -> Value:
        """Return a value within the range, as it is written."""
        if self.switch:
            return bool(value)
        return float(f"{min(max(value, self.search.low), self.search.high):.{_DIGITS}g}")


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

    def round(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return values within the ranges, as they are written."""
        return {one.name: one.round(values[one.name]) for one in self.dimensions}

    def values_of(self, configuration: Configuration) -> dict[str, Value]:
        """Return the values of a configuration; one outside its range is at the end of it."""
        return self.round({one.name: value_of(configuration, PARAMETERS[one.name].path) for one in self.dimensions})  # type: ignore[misc]

    def apply(self, base: Configuration, values: Mapping[str, Value]) -> Configuration:
        """The configuration with these values; raises ConfigurationError where they do not go together."""
        return override(base, *(f"{name}={str(value).lower()}" for name, value in values.items()))
