"""A localization between two scans as one file, so that it can be resumed with identical results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from gridslam.config.tables import replace_parameters, to_table
from gridslam.io.sessions.archive_file import (
    dump_generator,
    load_generator,
    name_file,
    read_sealed_arrays,
    read_text_array,
    write_sealed_arrays,
)
from gridslam.io.sessions.state_values import require_near_maps, require_plausible
from gridslam.io.text import parse_json
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.odometry_check import LOCAL_MAPS
from gridslam.localization.state import MonteCarloState
from gridslam.serialization import select_part

__all__ = ["SavedLocalization", "read_localization", "write_localization"]

_SCHEMA = "gridslam.saved_localization/6"
_WHAT = "a saved localization"


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedLocalization:
    """The complete state of a localization between two scans, except the map; continue it by `pipeline.run`.

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
    texts = {
        "schema": _SCHEMA,
        "configuration": json.dumps(to_table(saved.configuration)),
        "generator": json.dumps(dump_generator(saved.rng)),
    }
    arrays = {f"state.{name}": values for name, values in saved.state.to_arrays().items()}
    write_sealed_arrays(path, arrays | {name: np.array(text) for name, text in texts.items()})


def read_localization(path: str | Path) -> SavedLocalization:
    """Read a file of `write_localization`; resuming from it, in the same map, gives identical results.

    Raises
    ------
    InputError
        The file cannot be read, has another schema, or its arrays do not belong together.
    """
    arrays = read_sealed_arrays(path, _SCHEMA, _WHAT)
    with name_file(path, _WHAT):
        require_plausible(arrays)
        state = MonteCarloState.from_arrays(select_part(arrays, "state"))
        require_near_maps(arrays, LOCAL_MAPS.resolution_m)
        return SavedLocalization(
            replace_parameters(MonteCarloConfiguration(), parse_json(read_text_array(arrays, "configuration"))),
            state,
            load_generator(parse_json(read_text_array(arrays, "generator"))),
        )
