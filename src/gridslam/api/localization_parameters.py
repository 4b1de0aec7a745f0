"""Parameters of localization as text: gridslam's own dotted names and AMCL's, side by side."""

from __future__ import annotations

import json
from collections.abc import Iterable

from gridslam.api.amcl import AMCL_NAMES, AmclParameters, from_amcl
from gridslam.config.tables import Table, names, replace_parameters, suggest_names, to_table
from gridslam.errors import ConfigurationError
from gridslam.localization.monte_carlo import MonteCarloConfiguration

__all__ = ["override_configuration"]


def override_configuration(configuration: MonteCarloConfiguration, assignments: Iterable[str]) -> AmclParameters:
    """Change parameters by ``name=value``, AMCL's first and then gridslam's own (see `MonteCarloConfiguration`).

    Raises
    ------
    ConfigurationError
        An assignment is malformed, or a parameter is unknown, of a wrong type or out of range.
    """
    amcl: Table = {}
    changes: Table = {}
    for assignment in assignments:
        name, equals, text = (part.strip() for part in assignment.partition("="))
        if not (name and equals and text):
            raise ConfigurationError(f"expected name=value, got {assignment!r}")
        if name in AMCL_NAMES and name not in to_table(configuration):
            amcl[name] = _value(text)
        else:
            _put(changes, name, _value(text), configuration)
    read = from_amcl(amcl, configuration)
    return read._replace(configuration=replace_parameters(read.configuration, changes))


def _put(changes: Table, name: str, value: object, configuration: MonteCarloConfiguration) -> None:
    """Put a value into nested tables, under its dotted name."""
    *above, last = name.split(".")
    if [*above, last][0] not in to_table(configuration):
        raise ConfigurationError(
            f"{name}: no such parameter{suggest_names(name, [*names(configuration), *AMCL_NAMES])}"
        )
    for key in above:
        changes = changes.setdefault(key, {})
        if not isinstance(changes, dict):
            raise ConfigurationError(f"{name}: {key} was given as {changes!r} before")
    changes[last] = value


def _value(text: str) -> object:
    """A number, true or false, or the text itself."""
    try:
        value: object = json.loads(text)
        return value
    except json.JSONDecodeError:
        return text
