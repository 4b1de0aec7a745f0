"""A localization between two scans as one file, so that it can be resumed with identical results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.config.tables import replace_parameters, to_table
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.results.archive import read_arrays, write_arrays
from gridslam.io.results.generator import dump_generator, load_generator
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.state import MonteCarloState

__all__ = ["SavedLocalization", "read_localization", "write_localization"]

_SCHEMA = "gridslam.saved_localization/2"


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedLocalization:
    """All that a localization is between two scans, but the map: go on with `pipeline.run`.

    Attributes
    ----------
    configuration : MonteCarloConfiguration
        What the filter is put together from.
    state : MonteCarloState
        The filter's state; a file is written from it without consuming it.
    rng : numpy.random.Generator
        Over PCG64, as from `numpy.random.default_rng`, or PCG64DXSM.
    """

    configuration: MonteCarloConfiguration
    state: MonteCarloState
    rng: np.random.Generator


def write_localization(path: str | Path, saved: SavedLocalization) -> None:
    """Write to an .npz file of plain arrays and text (no pickle); it appears under its name once it is whole.

    Raises
    ------
    ArgumentError
        The generator's state is not plain integers.
    ConsumedStateError
        The state was given to the filter.
    OutputError
        The file cannot be written.
    """
    arrays: dict[str, Any] = {f"state.{name}": array for name, array in saved.state.to_arrays().items()}
    arrays["schema"] = np.array(_SCHEMA)
    arrays["configuration"] = np.array(json.dumps(to_table(saved.configuration)))
    arrays["generator"] = np.array(dump_generator(saved.rng))
    write_arrays(path, arrays)


def read_localization(path: str | Path) -> SavedLocalization:
    """Read what `write_localization` wrote; resuming from it, in the same map, gives identical results.

    Raises
    ------
    InputError
        The file cannot be read, has another schema, or its arrays do not belong together.
    """
    arrays = read_arrays(path, _SCHEMA, "a saved localization")
    own = {name.removeprefix("state."): array for name, array in arrays.items() if name.startswith("state.")}
    try:
        configuration = replace_parameters(MonteCarloConfiguration(), json.loads(str(arrays["configuration"])))
        return SavedLocalization(
            configuration, MonteCarloState.from_arrays(own), load_generator(str(arrays["generator"]))
        )
    except (ArgumentError, ConfigurationError, KeyError, ValueError) as error:
        raise InputError(path, f"expected a saved localization: {error}") from None
