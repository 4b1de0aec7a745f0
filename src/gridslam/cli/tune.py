"""gridslam tune."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from gridslam.api.evaluation import is_log
from gridslam.batch.engine import run_jobs
from gridslam.batch.job import Job
from gridslam.batch.manifest import find_logs
from gridslam.cli.batch import require_journal, scoring_options
from gridslam.cli.options import MapOptions, to_words
from gridslam.cli.output import counted, open_display, print_result, stop_if_interrupted
from gridslam.errors import InputError
from gridslam.io.limits import max_memory_bytes
from gridslam.io.log import LogOptions, open_log
from gridslam.io.output import write_atomically
from gridslam.io.text import compute_digest
from gridslam.tuning.report import describe_verdict, to_document, to_toml
from gridslam.tuning.search_space import SearchSpace
from gridslam.tuning.tune import Settings, TunedLog, Tuner, load_optuna

_BESIDE = (".relations", ".truth.tum", ".ref.tum", ".ref.tum.gz")


@dataclass(frozen=True)
class TuneOptions:
    """The options of `gridslam tune` that are not those of `gridslam map`, by their names."""

    trials: int
    reference: str | None
    held_out: tuple[str, ...]
    without_reference: bool
    names: tuple[str, ...]
    judging_seeds: int
    workers: int
    timeout_s: float | None

    def read_logs(self, logs: Sequence[str], options: LogOptions) -> list[TunedLog]:
        """Describe logs, those of the search first, but for their digests; raises InputError for a file that is none.

        Those that cannot be mapped are found by the first runs, before the search.
        """
        entries = find_logs([*logs, *self.held_out], reference=self.reference)
        searched = len(find_logs(logs))
        found = []
        for k, entry in enumerate(entries):
            stop_if_interrupted()
            open_log(entry.path, options)  # which names a file that is no log
            reference = None if self.without_reference else entry.reference or _find_reference(entry.path)
            if reference is not None and is_log(reference):
                raise InputError(reference, "expected a trajectory or relations, got a log")
            where = None if reference is None else os.fspath(reference)
            found.append(TunedLog(entry.name, entry.path, "", where, held_out=k >= searched))
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
    require_journal(folder)
    settings = Settings(
        base,
        space,
        tune.trials,
        given.seed,
        tune.judging_seeds,
        ("--repair", given.repair, *to_words(given.options)),
        ("--max-memory", str(max_memory_bytes() / 1e9)),
        scoring_options(given.options.to_dict()),
        given.threads,
    )
    with open_display(not as_json) as display:

        def run(jobs: Sequence[Job]) -> list[dict[str, Any]]:
            def on_row(row: object) -> None:
                display(lambda: _describe(tuner))

            return run_jobs(jobs, folder, workers=tune.workers, timeout_s=tune.timeout_s, on_row=on_row)

        tuner = Tuner(settings, chosen, run)
        tuning = tuner()
    document = to_document(tuning, settings, chosen, settings.trials)
    _write_text(folder / "tune.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
    _write_text(out, to_toml(tuning, chosen))
    tried = len({tuple(trial.values.items()) for trial in tuning.trials})
    verdict = describe_verdict(tuning, chosen)
    print_result(document, [f"tried {counted(tried, 'configuration')}", *verdict, f"{out}; details: {folder}"], as_json)


def _find_reference(log: str) -> Path | None:
    """File beside a log that has its name and is a reference: NAME.relations, NAME.truth.tum or NAME.ref.tum[.gz]."""
    path = Path(log)
    stem = path.name.partition(".")[0]
    return next((found for ending in _BESIDE if (found := path.with_name(stem + ending)).is_file()), None)


def _write_text(file: Path, text: str) -> None:
    with write_atomically(file) as path:
        path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _digest(log: TunedLog) -> TunedLog:
    """Return the log with the digest that identifies its results."""
    reference = None if log.reference is None else compute_digest(log.reference)
    return replace(log, digest=compute_digest(log.path), reference_digest=reference)


def _describe(tuner: Tuner) -> tuple[float, str]:
    """Return the share of the trials that are made, and a line about them."""
    done = tuner.trials
    if not done:
        return 0.0, "the configuration that the search begins with"
    best = min(one.ratio for one in done)
    share = len(done) / tuner.settings.trials
    return share, f"trial {len(done)}, best {best:.3f} times the start's error"
