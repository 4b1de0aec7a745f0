"""gridslam batch."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Literal, final

import click

from gridslam.api.amcl import AmclParameters
from gridslam.batch.engine import MOST_WORKERS, run_jobs
from gridslam.batch.job import Job, compute_key
from gridslam.batch.journal import JOURNAL, Journal
from gridslam.batch.manifest import COLUMNS, Entry, find_logs
from gridslam.cli.localize import read_parameters
from gridslam.cli.options import MapOptions, localize_options, log_options, map_options
from gridslam.cli.output import counted, open_display, warn
from gridslam.config.tables import suggest_names
from gridslam.errors import ConfigurationError, GridslamError, InputError, OutputError
from gridslam.io.limits import max_memory_bytes
from gridslam.io.log import LogOptions
from gridslam.io.maps import read_map_description
from gridslam.io.text import measure_size
from gridslam.parameters import to_table

_TRUE = ("1", "true", "yes", "on")
_FALSE = ("0", "false", "no", "off")

_Repair = Literal["needed", "none"]


def run_batch(
    logs: Sequence[str],
    out: Path,
    command: str,
    reference: str | None,
    workers: int | None,
    timeout_s: float | None,
    as_json: bool,
    words: Sequence[str],
) -> int:
    """Run a command over many logs; returns the exit status."""
    make = _Maker(command, words)
    entries = find_logs(logs, reference=reference)
    # the largest first: the last one is waited for alone
    prepared = [(entry, *make.prepare(entry)) for entry in sorted(entries, key=lambda entry: -_measure(entry.path))]
    require_journal(out)
    jobs = _make_jobs(command, prepared)
    counts: Counter[str] = Counter()

    began_s = time.perf_counter()

    def describe() -> tuple[float, str]:
        ended = counts["done"] + counts["failed"]
        return ended / len(jobs), f"{ended} of {len(jobs)} logs{_failed(counts)}"

    with open_display(not as_json) as display:

        def on_row(row: Mapping[str, Any]) -> None:
            counts.update([row["status"]] + ["resumed"] * (row["resumed"] and row["status"] == "done"))
            display(describe)
            if as_json:
                click.echo(json.dumps({name: value for name, value in row.items() if name != "document"}))
            elif row["status"] == "failed":
                warn(f"{row['log']}: {row['error']}: {row['message']}")

        run_jobs(jobs, out, workers=workers or _count_processors(), timeout_s=timeout_s, on_row=on_row)
    if not as_json:
        earlier = f" ({counts['resumed']} of them before)" if counts["resumed"] else ""
        done = f"{counts['done']} done{earlier}{_failed(counts)}"
        click.echo(
            f"{counted(len(jobs), 'log')}: {done}, in {time.perf_counter() - began_s:.1f} s\nrows: {out / JOURNAL}"
        )
    return 1 if counts["failed"] else 0


def _failed(counts: Mapping[str, int]) -> str:
    return f", {counts['failed']} failed" if counts["failed"] else ""


def _count_processors() -> int:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(count, MOST_WORKERS)


def require_journal(out: Path) -> None:
    """Check that the journal of a batch can be written to OUT before the long work; else that is bad usage."""
    try:
        with Journal(out):
            pass
    except OutputError as error:
        raise click.ClickException(str(error)) from None


@final
class _Maker:
    """Reads the options of a command, as on its own command line, before any job begins."""

    def __init__(self, command: str, words: Sequence[str]) -> None:
        """Take the options that hold for all logs."""
        self._command = command
        self._words = tuple(words)
        self._read = cache(self._parse)
        self._parser = _PARSERS[command]
        self._known = {
            option.removeprefix("--"): parameter
            for parameter in self._parser.params
            if isinstance(parameter, click.Option)
            for option in parameter.opts
            if option.startswith("--")
        }

    def prepare(self, entry: Entry) -> tuple[tuple[str, ...], dict[str, Any]]:
        """Return the options of a log and their values; raises InputError for an unknown column."""
        if self._command == "doctor" and entry.reference is not None:
            raise click.ClickException("doctor has no use for a reference")
        words = tuple(word for name, value in entry.options.items() for word in self._to_words(entry, name, value))
        if not words:
            return self._words, self._read(self._words)
        try:
            return self._words + words, self._read(self._words + words)
        except (click.ClickException, GridslamError) as error:
            text = error.format_message() if isinstance(error, click.ClickException) else str(error)
            raise ConfigurationError(f"{entry.where}: {text}") from None

    def _to_words(self, entry: Entry, name: str, value: str) -> list[str]:
        option = self._known.get(name)
        if option is None:
            names = [*COLUMNS, *self._known]
            path, _, _ = entry.where.rpartition(", line ")
            expected = f"{', '.join(COLUMNS)} or an option of gridslam {self._command}"
            raise InputError(path, f"unknown column {name!r}: expected {expected}{suggest_names(name, names)}", 1)
        if not option.is_flag:
            return [f"--{name}={value}"]
        if value.lower() not in (*_TRUE, *_FALSE):
            raise ConfigurationError(f"{entry.where}: {name}: expected true or false, got {value!r}")
        return [f"--{name}"] if value.lower() in _TRUE else []

    def _parse(self, words: tuple[str, ...]) -> dict[str, Any]:
        name = f"gridslam {self._command}"
        values: dict[str, Any] = self._parser.main(list(words), prog_name=name, standalone_mode=False)
        return values


@click.command("map", add_help_option=False)
@map_options
def _read_map(given: MapOptions) -> dict[str, Any]:
    return {
        "configuration": to_table(given.configuration()),
        "seed": given.seed,
        "threads": given.threads,
        "options": given.options.to_dict(),
        "repair": given.repair,
    }


@click.command("localize", add_help_option=False)
@localize_options
def _read_localize(
    map_path: Path,
    initial_pose: tuple[float, float, float] | None,
    strict_thresholds: bool,
    preset: str,
    config: Path | None,
    particles: int | None,
    assignments: Sequence[str],
    seed: int,
    threads: int,
    options: LogOptions,
    repair: _Repair,
) -> dict[str, Any]:
    read: AmclParameters = read_parameters(preset, config, particles, assignments)
    pose = read.pose if initial_pose is None else initial_pose
    return {
        "map": os.path.abspath(map_path),
        "pose": None if pose is None else [float(value) for value in pose],
        "covariance": read.covariance.tolist(),
        "strict_thresholds": strict_thresholds,
        "configuration": to_table(read.configuration),
        "seed": seed,
        "threads": threads,
        "options": options.to_dict(),
        "repair": repair,
    }


@click.command("doctor", add_help_option=False)
@log_options
def _read_doctor(options: LogOptions) -> dict[str, Any]:
    return {"options": options.to_dict()}


_PARSERS = {"map": _read_map, "doctor": _read_doctor, "localize": _read_localize}


def _make_jobs(command: str, prepared: Sequence[tuple[Entry, tuple[str, ...], Mapping[str, Any]]]) -> list[Job]:
    describe = cache(_describe)
    find_image = cache(_find_image)
    jobs = []
    for entry, words, values in prepared:
        files = [entry.reference] if entry.reference else []
        files += [values["map"], find_image(values["map"])] if "map" in values else []
        parameters = {name: value for name, value in values.items() if name != "threads"}
        parameters["files"] = [describe(path) for path in files]
        key = compute_key(command, describe(entry.path), parameters)
        every = ("--max-memory", str(max_memory_bytes() / 1e9), command, entry.path, *words)
        every += ("--no-history",) * (command != "doctor")
        scoring = () if entry.reference is None else (entry.reference, *scoring_options(values["options"]))
        jobs.append(Job(every, entry.log, entry.name, key, command, scoring=scoring))
    return jobs


def scoring_options(options: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the options of `gridslam evaluate` for a run on the part of a log that these options choose."""
    return ("--part",) if options["duration_s"] is not None or options["start_s"] > 0 else ()


def _measure(path: str) -> int:
    """Size of a log, if it is there."""
    with suppress(Exception):  # whatever is wrong with one log, its job reports it
        return measure_size(Path(path))
    return 0


def _find_image(path: str) -> str:
    """Image of a map; the map's file itself where it cannot be read, which the jobs report."""
    with suppress(Exception):
        return os.path.join(os.path.dirname(path), read_map_description(path).image)
    return path


def _describe(path: str) -> str:
    """Return size and time of modification of a file, or of all in a folder.

    Of one that cannot be read nothing is known, and its job reports it.
    """
    with suppress(Exception):
        files = sorted(Path(path).rglob("*")) if os.path.isdir(path) else [Path(path)]
        return " ".join(f"{file.stat().st_size} {file.stat().st_mtime_ns} {file.name}" for file in files)
    return ""
