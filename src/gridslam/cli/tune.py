"""gridslam tune."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import click

from gridslam.batch.engine import run_jobs
from gridslam.batch.job import Job
from gridslam.batch.manifest import find_logs
from gridslam.cli.options import MapOptions
from gridslam.cli.output import open_display, print_result, stop_if_interrupted, write_apart
from gridslam.errors import InputError
from gridslam.io.limits import max_memory_bytes
from gridslam.io.log import LogOptions, open_log
from gridslam.io.output import write_atomically
from gridslam.io.text import compute_digest
from gridslam.tuning.report import describe_verdict, to_document, to_toml
from gridslam.tuning.search_space import SearchSpace
from gridslam.tuning.trial import find_reference
from gridslam.tuning.tune import Settings, Trial, TunedLog, Tuner, load_optuna

__all__ = ["TuneOptions", "run_tune"]


@dataclass(frozen=True)
class TuneOptions:
    """The options of `gridslam tune` that are not those of `gridslam map`, by their names."""

    trials: int
    reference: str | None
    held_out: tuple[str, ...]
    split: float | None
    without_reference: bool
    names: tuple[str, ...]
    judging_seeds: int
    workers: int
    timeout_s: float | None

    def read_logs(self, logs: Sequence[str], options: LogOptions) -> list[TunedLog]:
        """Describe logs, those of the search first, but for their digests; raises InputError for one of no use."""
        entries = find_logs([*logs, *self.held_out], reference=self.reference)
        searched = len(find_logs(logs))
        if self.split:
            searched = max(1, round((1 - self.split) * searched))
        found = []
        for k, entry in enumerate(entries):
            log = open_log(entry.path, options)
            for _ in log:
                stop_if_interrupted()
            duration_s = log.statistics.duration_s
            if not duration_s > 0:
                raise InputError(entry.path, "expected a log of more than one scan")
            reference = None if self.without_reference else entry.reference or find_reference(entry.path)
            where = None if reference is None else os.fspath(reference)
            found.append(TunedLog(entry.name, entry.path, "", duration_s, where, held_out=k >= searched))
        return found


def run_tune(logs: Sequence[str], out: Path, given: MapOptions, tune: TuneOptions, as_json: bool) -> None:
    """Search parameters for logs, and write the configuration to use, tune.json, the figures and the journal."""
    base = given.configuration()
    space = SearchSpace.of(base, tune.names)
    folder = out.with_suffix(".tune")
    if folder == out:
        raise click.ClickException(f"{out}: expected the name of a file to write, as best.toml")
    load_optuna()
    read = tune.read_logs(logs, given.options)
    chosen = [_digest(log) for log in read]
    settings = Settings(
        base,
        space,
        tune.trials,
        given.seed,
        tune.judging_seeds,
        given.options,
        given.repair,
        max_memory_bytes(),
        given.threads,
    )
    with _Progress(not as_json) as progress:

        def run(jobs: Sequence[Job]) -> list[dict[str, Any]]:
            return run_jobs(jobs, folder, workers=tune.workers, timeout_s=tune.timeout_s, on_poll=progress.on_poll)

        tuner = Tuner(settings, chosen, run, progress.on_trial)
        progress.watch(tuner)
        tuning = tuner()
    document = to_document(tuning, settings, chosen, settings.trials)
    with write_apart() as write:
        write(_write_text, out, to_toml(tuning, chosen))
        write(_write_text, folder / "tune.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
        tried = len({tuple(trial.values.items()) for trial in tuning.trials})
        lines = [f"{tried} configurations were tried", *describe_verdict(tuning, chosen), f"{out}; details: {folder}"]
        print_result(document, lines, as_json)


def _write_text(file: Path, text: str) -> None:
    with write_atomically(file) as path:
        path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _digest(log: TunedLog) -> TunedLog:
    """Return the log with the digest that identifies its results."""
    reference = None if log.reference is None else compute_digest(log.reference)
    return replace(log, digest=compute_digest(log.path), reference_digest=reference)


@final
class _Progress:
    """Shows on standard error how far a tuning is."""

    def __init__(self, shown: bool) -> None:
        """Open the display when the context is entered."""
        self._shown = shown
        self._stack = ExitStack()
        self._tuner: Tuner | None = None
        self._text = "the configuration that the search begins with"

    def __enter__(self) -> _Progress:
        """Open the display."""
        self._show, self._every_s = self._stack.enter_context(open_display(self._shown))
        self._due = time.perf_counter() + self._every_s
        return self

    def __exit__(self, *error: object) -> None:
        """Close the display."""
        self._stack.close()

    def watch(self, tuner: Tuner) -> None:
        """Show the progress of this one."""
        self._tuner = tuner

    def on_trial(self, trial: Trial) -> None:
        """Show a trial."""
        assert self._tuner is not None
        done = self._tuner.trials
        whole = [one.ratio for one in done if one.part == 1.0]
        best = f", best {min(whole):.3f} times the start's error" if whole else ""
        self._text = f"on {trial.part:.0%} of the logs: trial {len(done)}{best}"

    def on_poll(self) -> None:
        """Show how far it is, and stop if interrupted."""
        stop_if_interrupted()
        now = time.perf_counter()
        if now >= self._due and self._tuner is not None:
            self._due = now + self._every_s
            self._show(min(len(self._tuner.trials) / self._tuner.settings.trials, 1.0), self._text)
