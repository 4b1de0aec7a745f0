"""A run between two scans as one file, so that it can be resumed with identical results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.config import Configuration, dumps, loads
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.results.archive import read_arrays, write_arrays
from gridslam.io.results.generator import dump_generator, load_generator
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.slam.grid_fastslam.state import GridFastSlamState

__all__ = ["SavedRun", "read_state", "write_state"]

_SCHEMA = "gridslam.saved_run/4"


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


def write_state(path: str | Path, run: SavedRun) -> None:
    """Write a run to an .npz file of plain arrays and text (no pickle); it appears under its name once it is whole.

    Raises
    ------
    ArgumentError
        The generator's state is not plain integers.
    OutputError
        The file cannot be written.
    """
    generator = dump_generator(run.rng)
    parts = {
        "state": run.state.to_arrays(),
        "trajectory": run.trajectory.to_arrays(),
        "statistics": run.statistics.to_arrays(),
    }
    arrays: dict[str, Any] = {f"{part}.{name}": array for part, own in parts.items() for name, array in own.items()}
    arrays["schema"] = np.array(_SCHEMA)
    arrays["configuration"] = np.array(dumps(run.configuration))
    arrays["generator"] = np.array(generator)
    write_arrays(path, arrays)


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
    arrays = read_arrays(path, _SCHEMA, "a saved run")

    def part(prefix: str) -> dict[str, NDArray[Any]]:
        return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(prefix + ".")}

    try:
        configuration = loads(_text(arrays, "configuration"))
        return SavedRun(
            configuration,
            GridFastSlamState.from_arrays(part("state"), configuration.mapper, threads),
            load_generator(_text(arrays, "generator")),
            TrajectoryRecorder.from_arrays(part("trajectory")),
            StatisticsRecorder.from_arrays(part("statistics")),
        )
    except (ArgumentError, ConfigurationError) as error:
        raise InputError(path, f"expected a saved run: {error}") from None


def _text(arrays: Mapping[str, NDArray[Any]], name: str) -> str:
    if name not in arrays:
        raise ArgumentError("arrays", f"a text named {name}", sorted(arrays))
    return str(arrays[name])
