"""Predict the cost of the jobs of a batch: for their order, their limits and the remaining time."""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

from gridslam.batch.job import Job
from gridslam.batch.runs import Run
from gridslam.evaluation.cost import DEFAULT_COSTS, Cost, CostModel, Work, fit_costs

__all__ = ["Estimator", "estimate", "find_work", "limit_memory"]

_LEAST_LOGS = 8
"""From this many logs on the costs are fitted to the batch itself: as many as would determine the coefficients."""

_SCANS_PER_BYTE: Final = {".gz": 1 / 260, ".bz2": 1 / 170, ".bag": 1 / 6000, ".mcap": 1 / 4000, "": 1 / 1200}
"""Scans of a log for each byte of its file, by the suffix, until logs of this kind have been run."""

_KEY_SCANS_PER_SCAN = 0.2
_OTHER_COMMANDS: Final = {"doctor": 0.3, "localize": 1.0, "evaluate": 0.01}
"""Cost beside that of mapping."""

_LEAST_LIMIT_BYTES = 2_000_000_000
_MEMORY_FACTOR = 4.0
"""Limits are generous: a wrong one costs a log, and a log that needs without bound exceeds any."""


@final
@dataclass(frozen=True)
class Estimator:
    """Estimates the cost of logs from their sizes, and from runs that have ended.

    Attributes
    ----------
    model : CostModel
        Cost of some work.
    scans_per_byte : dict of str to float
        By the suffix of the file.
    key_scans_per_scan : float
        Of the logs that were run.
    known : dict of str to Work
        Of logs that were run, by their names.
    """

    model: CostModel
    scans_per_byte: dict[str, float]
    key_scans_per_scan: float
    known: dict[str, Work]

    @classmethod
    def learn(cls, runs: Iterable[Run]) -> Estimator:
        """Fit the estimate to the runs of earlier batches; defaults remain where these give no data."""
        work: list[Work] = []
        costs: list[Cost] = []
        ratios: dict[str, list[float]] = {}
        known: dict[str, Work] = {}
        for run in runs:
            done = find_work(run)
            cpu, memory = run.row["cpu_s"], run.row["peak_memory_bytes"]
            if done is None or not cpu or not memory:
                continue
            work.append(done)
            costs.append(Cost(cpu, memory))
            known[run.row["log"]] = done
            if size := run.figures.get("bytes"):
                ratios.setdefault(_suffix(run.row["log"]), []).append(done.scans / size)
        enough = len(known) >= _LEAST_LOGS
        return cls(
            fit_costs(work, costs) if enough else DEFAULT_COSTS,
            _SCANS_PER_BYTE | {suffix: statistics.median(values) for suffix, values in ratios.items()},
            statistics.median(each.key_scans / each.scans for each in work) if work else _KEY_SCANS_PER_SCAN,
            known,
        )

    def estimate(self, log: str, size_bytes: int, particles: int, command: str = "map") -> Cost:
        """Estimate the cost of a job, of a log that was run before or of one whose size is all that is known."""
        work = self.known.get(log)
        if work is None:
            suffix = _suffix(log)
            scans = size_bytes * self.scans_per_byte.get(suffix, self.scans_per_byte[""])
            work = Work(scans, scans * self.key_scans_per_scan, particles)
        cost = self.model.estimate(replace(work, particles=particles))
        return Cost(cost.cpu_s * _OTHER_COMMANDS.get(command, 1.0), cost.memory_bytes)


def estimate(jobs: Sequence[Job], runs: Iterable[Run]) -> list[Cost]:
    """Estimate the cost of jobs from the sizes of their logs and from runs that have ended.

    Parameters
    ----------
    jobs : sequence of Job
        Of `gridslam batch`: their arguments hold the size of the log, and the configuration. A log whose size is
        unknown, as one at a URL, is taken to be as large as the mean of the others.
    runs : iterable of Run
        Of the same or of another batch; may be empty.

    Returns
    -------
    list of Cost
        In the order of `jobs`.
    """
    estimator = Estimator.learn(runs)
    sizes = [job.arguments["bytes"] for job in jobs]
    seen = [size for size in sizes if size]
    typical = round(statistics.fmean(seen)) if seen else 1_000_000
    return [
        estimator.estimate(job.log, size or typical, _particles(job.arguments), job.command)
        for job, size in zip(jobs, sizes, strict=True)
    ]


def limit_memory(cost: Cost) -> int:
    """Return the limit of the address space of a job, bytes: four times its estimate, and at least 2 GB."""
    return max(_LEAST_LIMIT_BYTES, round(_MEMORY_FACTOR * cost.memory_bytes))


def find_work(run: Run) -> Work | None:
    """Return the work done by a run of map; None for other runs and for failed ones."""
    figures = run.figures
    if not run.is_done or not figures.get("scans") or "particles" not in figures or "map_width_m" not in figures:
        return None
    area = figures["map_width_m"] * figures["map_height_m"]
    return Work(figures["scans"], figures["key_scans"], round(figures["particles"]), area)


def _suffix(log: str) -> str:
    return os.path.splitext(log.partition("?")[0])[1].lower()


def _particles(arguments: dict[str, Any]) -> int:
    particles = arguments.get("configuration", {}).get("particles", 30)
    return particles if isinstance(particles, int) else 30
