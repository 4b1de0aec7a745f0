"""The commands that a job of `gridslam batch` runs: map, doctor, localize; arguments are a JSON object."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gridslam.api.diagnosis import check_log, describe_finding, write_diagnosis
from gridslam.api.evaluation import score_against_reference
from gridslam.api.localization import LocalizationResult, localize
from gridslam.api.mapping import MapResult, map_log
from gridslam.config import Configuration
from gridslam.config.tables import replace_parameters
from gridslam.doctor import diagnose
from gridslam.io.limits import limit_memory
from gridslam.io.log import Log, LogOptions, open_log
from gridslam.io.output import OutputFolder
from gridslam.localization.monte_carlo import MonteCarloConfiguration


def run_map(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Map a log into a folder as `gridslam map` does.

    Parameters
    ----------
    arguments : mapping
        ``log``, its path; ``configuration``, a table of parameters; ``seed``, ``threads``, ``repair``; ``options``, the
        fields of `LogOptions`; ``max_memory_bytes``; ``reference``, a file of relations or a true trajectory, or None;
        ``out`` and ``job`` (see `Job`).

    Returns
    -------
    dict
        The content of run.json; with a reference, its scores under ``evaluation``.
    """
    with _open_output(arguments, MapResult.all_names()) as folder:
        log = _open(arguments)
        result = map_log(
            log,
            configuration=replace_parameters(Configuration(), arguments["configuration"]),
            seed=arguments["seed"],
            threads=arguments["threads"],
            repair=arguments["repair"],
            keep_particles=False,
            on_finding=lambda finding: _warn(describe_finding(log, finding)),
        )
        _warn(*result.warnings(), *result.failures)
        return _write(result, folder, arguments)


def run_localize(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Localize a log in a map as `gridslam localize` does; arguments as of `run_map`, and of `localize`."""
    with _open_output(arguments, LocalizationResult.all_names()) as folder:
        result = localize(
            _open(arguments),
            arguments["map"],
            pose=arguments["pose"],
            covariance=arguments["covariance"],
            strict_thresholds=arguments["strict_thresholds"],
            configuration=replace_parameters(MonteCarloConfiguration(), arguments["configuration"]),
            seed=arguments["seed"],
            threads=arguments["threads"],
            repair=arguments["repair"],
        )
        _warn(*result.warnings(), *result.failures)
        return _write(result, folder, arguments)


def run_doctor(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Diagnose a log as `gridslam doctor` does; returns the content of report.json."""
    with _open_output(arguments) as folder:
        diagnosis = diagnose(open_log(arguments["log"], _read_options(arguments)))
        document = write_diagnosis(diagnosis, folder) | {"job": arguments["job"]}
        folder.write_json("run.json", document)
        return document


@contextmanager
def _open_output(arguments: Mapping[str, Any], names: Sequence[str] = ()) -> Iterator[OutputFolder]:
    """Open OUT for a job, with the memory that it may use."""
    with limit_memory(arguments["max_memory_bytes"]), OutputFolder(arguments["out"], names) as folder:
        yield folder


def _write(
    result: MapResult | LocalizationResult, folder: OutputFolder, arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the results; run.json also contains the job, and the scores where there is a reference."""
    if any("MemoryError" in failure for failure in result.failures):
        raise MemoryError(result.failures[0])  # what a limit of memory leaves out is no result of the log
    document = result.write(folder) | {"job": arguments["job"]}
    reference = arguments["reference"]
    if reference is not None:
        source = Path(arguments["out"]) / "trajectory.tum"
        options = _read_options(arguments)
        is_part = options.duration_s is not None or options.start_s > 0
        scores = score_against_reference(result.trajectory, source, reference, is_part=is_part)
        document["evaluation"] = {"reference": reference} | scores
    folder.write_json("run.json", document)
    return document


def _open(arguments: Mapping[str, Any]) -> Log:
    """Open the log; faults at its beginning go to standard error, and so to the row's output."""
    options = _read_options(arguments)
    return check_log(open_log(arguments["log"], options), options, _warn)


def _read_options(arguments: Mapping[str, Any]) -> LogOptions:
    return LogOptions.from_dict(arguments["options"])


def _warn(*warnings: str) -> None:
    for warning in warnings:
        print(warning, file=sys.stderr)
