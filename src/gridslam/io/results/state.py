"""A run or a localization between two scans as one file, so that it can be resumed with identical results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.config import Configuration, dumps, loads
from gridslam.config.tables import replace_parameters, to_table
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.output import write_atomically
from gridslam.io.results.record import read_arrays
from gridslam.io.results.state_values import require_near_maps, require_plausible
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.state import MonteCarloState
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.serialization import select_part
from gridslam.slam.grid_fastslam.state import GridFastSlamState

__all__ = ["SavedLocalization", "SavedRun", "read_localization", "read_state", "write_localization", "write_state"]

_RUN_SCHEMA = "gridslam.saved_run/5"
_LOCALIZATION_SCHEMA = "gridslam.saved_localization/5"
_GENERATORS = {"PCG64": np.random.PCG64, "PCG64DXSM": np.random.PCG64DXSM}
"""Bit generators whose state is plain integers; the first is that of `numpy.random.default_rng`."""
_Arrays: TypeAlias = Mapping[str, NDArray[Any]]


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """All that a run is between two scans: build the filter from `configuration`, and go on with `pipeline.run`.

    Attributes
    ----------
    configuration : Configuration
        What the filter is built from.
    state : GridFastSlamState
        The filter's state; a file is written from it without consuming it.
    rng : numpy.random.Generator
        Over PCG64, as from `numpy.random.default_rng`, or PCG64DXSM.
    trajectory : TrajectoryRecorder
        The scans so far; their number is that of the processed measurements of the log.
    statistics : StatisticsRecorder
        Counts and latencies so far.
    """

    configuration: Configuration
    state: GridFastSlamState
    rng: np.random.Generator
    trajectory: TrajectoryRecorder = field(default_factory=TrajectoryRecorder)
    statistics: StatisticsRecorder = field(default_factory=StatisticsRecorder)


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


def write_state(path: str | Path, run: SavedRun) -> None:
    """Write a run to an .npz file of plain arrays and text (no pickle); it appears under its name once it is whole.

    Raises
    ------
    ArgumentError
        The generator's state is not plain integers.
    OutputError
        The file cannot be written.
    """
    parts = {
        "state": run.state.to_arrays(),
        "trajectory": run.trajectory.to_arrays(),
        "statistics": run.statistics.to_arrays(),
    }
    _write(path, parts, _RUN_SCHEMA, dumps(run.configuration), run.rng)


def read_state(path: str | Path, threads: int = 1) -> SavedRun:
    """Read a run; resuming from it gives the same results as without interruption.

    Parameters
    ----------
    path : str or Path
        What `write_state` wrote.
    threads : int
        Threads of the kernels; never changes a result.

    Raises
    ------
    InputError
        The file cannot be read, has another schema, or its arrays do not belong together.
    """
    arrays = read_arrays(path, _RUN_SCHEMA, "a saved run")
    with _name_file(path, "a saved run"):
        require_plausible(arrays)
        configuration = loads(_text(arrays, "configuration"))
        state = GridFastSlamState.from_arrays(select_part(arrays, "state"), configuration.mapper, threads)
        require_near_maps(arrays, configuration.mapper.resolution_m)
        return SavedRun(
            configuration,
            state,
            _load_generator(_text(arrays, "generator")),
            TrajectoryRecorder.from_arrays(select_part(arrays, "trajectory")),
            StatisticsRecorder.from_arrays(select_part(arrays, "statistics")),
        )


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
    configuration = json.dumps(to_table(saved.configuration))
    _write(path, {"state": saved.state.to_arrays()}, _LOCALIZATION_SCHEMA, configuration, saved.rng)


def read_localization(path: str | Path) -> SavedLocalization:
    """Read what `write_localization` wrote; resuming from it, in the same map, gives identical results.

    Raises
    ------
    InputError
        The file cannot be read, has another schema, or its arrays do not belong together.
    """
    arrays = read_arrays(path, _LOCALIZATION_SCHEMA, "a saved localization")
    with _name_file(path, "a saved localization"):
        require_plausible(arrays)
        return SavedLocalization(
            replace_parameters(MonteCarloConfiguration(), json.loads(_text(arrays, "configuration"))),
            MonteCarloState.from_arrays(select_part(arrays, "state")),
            _load_generator(_text(arrays, "generator")),
        )


@contextmanager
def _name_file(path: str | Path, what: str) -> Iterator[None]:
    """Raise InputError where arrays do not make a state; some come from numbers that belong together, and do not."""
    try:
        yield
    except (ArgumentError, ConfigurationError) as error:
        raise InputError(path, f"expected {what}: {error}") from None
    except (ValueError, TypeError, KeyError, IndexError, ArithmeticError, RecursionError) as error:
        problem = f"its arrays do not belong together: {error or type(error).__name__}"
        raise InputError(path, f"expected {what}: {problem}") from None


def _write(
    path: str | Path, parts: Mapping[str, _Arrays], schema: str, configuration: str, rng: np.random.Generator
) -> None:
    texts = {"schema": schema, "configuration": configuration, "generator": _dump_generator(rng)}
    arrays = {f"{part}.{name}": array for part, own in parts.items() for name, array in own.items()}
    arrays |= {name: np.array(text) for name, text in texts.items()}
    with write_atomically(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # none is named allow_pickle


def _text(arrays: _Arrays, name: str) -> str:
    if name not in arrays:
        raise ArgumentError("arrays", f"a text named {name}", sorted(arrays))
    return str(arrays[name])


def _dump_generator(rng: np.random.Generator) -> str:
    """State of a generator as JSON; raises ArgumentError where it is not plain integers."""
    state = rng.bit_generator.state
    if state["bit_generator"] not in _GENERATORS:
        raise ArgumentError("rng", f"a generator over {' or '.join(_GENERATORS)}", state["bit_generator"])
    return json.dumps(state)


def _load_generator(text: str) -> np.random.Generator:
    """Generator that goes on where that of the text was; raises ArgumentError where the text is none."""
    try:
        state = json.loads(text)
        bits = _GENERATORS[state["bit_generator"]]()
        bits.state = state
    except (ValueError, KeyError, TypeError) as error:
        raise ArgumentError("generator", f"the state of {' or '.join(_GENERATORS)} as JSON", error) from None
    return np.random.Generator(bits)
