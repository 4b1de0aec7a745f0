"""The search by Optuna, and a comparison of the best with the start on runs that chose neither."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from gridslam.batch.job import Job, compute_key
from gridslam.config import Configuration, dumps
from gridslam.errors import ArgumentError, InputError, MissingDependencyError
from gridslam.parameters import to_table
from gridslam.tuning.comparison import Comparison, Pair, compare
from gridslam.tuning.search_space import SearchSpace, Value
from gridslam.types import FloatArray

_TRIALS_PER_DIMENSION: Final = 3
"""Fewer than these cannot show that there is no gain."""

_BATCH: Final = 8
"""Configurations that are asked for together, so that workers have something to do."""
_LOSSES: Final = {"relations": "trans_mean_m", "ate": "trans_rmse_m", "self_consistency": "nats_per_beam"}
"""Figure of each kind of scores of `gridslam evaluate` that is the loss: m, m, nats a beam."""
_WORST: Final = 1e6
"""Ratio that stands for a configuration that fails."""

Row = dict[str, Any]


@final
@dataclass(frozen=True, slots=True)
class TunedLog:
    """A log of the search, or one that is held out from it.

    `reference` is None where self-consistency is the score.
    """

    name: str
    path: str
    digest: str
    reference: str | None = None
    reference_digest: str | None = None
    held_out: bool = False


@final
@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a tuning, independent of the logs.

    Attributes
    ----------
    base : Configuration
        Where the search begins, and what its result is compared with.
    space : SearchSpace
        What is searched.
    trials : int
        Configurations to try.
    seed : int
        Of the search, and of its runs; those that judge have the next ones.
    judging_seeds : int
        Runs of each log by which the best is judged, each with a seed of its own.
    options : tuple of str
        Options of `gridslam map` that choose a part of each log, and what is repaired.
    program_options, evaluate_options : tuple of str
        Options of `gridslam` itself, and of `gridslam evaluate`.
    threads : int
        As in `map_log`.
    """

    base: Configuration
    space: SearchSpace
    trials: int
    seed: int = 0
    judging_seeds: int = 5
    options: tuple[str, ...] = ()
    program_options: tuple[str, ...] = ()
    evaluate_options: tuple[str, ...] = ()
    threads: int = 1


@final
@dataclass(frozen=True, slots=True)
class Trial:
    """A configuration that was tried, and the loss of each log, infinite where one failed.

    `ratio` is its loss as a ratio to the start's, geometric mean over the logs.
    """

    values: dict[str, Value]
    losses: dict[str, float]
    ratio: float


@final
@dataclass(frozen=True, slots=True)
class Tuning:
    """The result of a search.

    Attributes
    ----------
    configuration : Configuration
        The one to use: the best where it is better than the start beyond the noise, else the start.
    comparison : Comparison or None
        The best against the start; None where nothing that was tried was better.
    enough : int
        Trials that it takes at least to exclude a gain.
    pairs : tuple of Pair
        The runs of the comparison.
    best : Trial
        The best on the logs of the search.
    trials : tuple of Trial
        All, in their order.
    """

    configuration: Configuration
    comparison: Comparison | None
    pairs: tuple[Pair, ...]
    best: Trial
    trials: tuple[Trial, ...]
    enough: int = 0

    @property
    def gains(self) -> bool:
        """Whether another configuration than the start is recommended."""
        return self.comparison is not None and self.comparison.gains


@final
@dataclass(slots=True)
class Tuner:
    """Runs a search; all that is random in it comes from its seed.

    Parameters
    ----------
    settings : Settings
        What to do.
    logs : sequence of TunedLog
        At least one that is not held out.
    run : callable
        Runs jobs, and gives a row of the journal for each (see `run_jobs`).
    """

    settings: Settings
    logs: Sequence[TunedLog]
    run: Callable[[Sequence[Job]], Sequence[Row]]
    trials: list[Trial] = field(default_factory=list, init=False)
    _rows: dict[str, Row] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        """Check that there is something to search on."""
        if not self._searched:
            raise ArgumentError("logs", "at least one that is not held out", "none")

    def __call__(self) -> Tuning:
        """Search, judge and return the result.

        Raises
        ------
        InputError
            A log, of the search or held out, cannot be mapped with the configuration that the search begins with.
        """
        settings = self.settings
        space = settings.space
        base = self._require_base()
        start = space.values_of(settings.base)
        self._search(start, base)
        best = min([Trial(start, base, 1.0), *self.trials], key=lambda trial: trial.ratio)
        pairs = self._judge(best.values) if best.ratio < 1 else []
        comparison = compare(pairs) if pairs else None
        gains = comparison is not None and comparison.gains
        return Tuning(
            space.apply(settings.base, best.values) if gains else settings.base,
            comparison,
            tuple(pairs),
            best,
            tuple(self.trials),
            _TRIALS_PER_DIMENSION * len(space.dimensions),
        )

    @property
    def _searched(self) -> list[TunedLog]:
        return [log for log in self.logs if not log.held_out]

    @property
    def judged(self) -> list[TunedLog]:
        """The logs that the best is judged on: those held out, else those of the search."""
        return [log for log in self.logs if log.held_out] or self._searched

    def _search(self, start: dict[str, Value], base: dict[str, float]) -> None:
        """Try the configurations that Optuna asks for, until all are tried.

        The default values are the first. The start is known, and no trial.
        """
        optuna = load_optuna()
        space = self.settings.space
        study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=self.settings.seed))
        distributions = {one.name: one.distribution() for one in space.dimensions}
        study.add_trial(optuna.trial.create_trial(params=start, distributions=distributions, value=1.0))
        default = space.values_of(Configuration())
        if default != start:
            study.enqueue_trial(default)
        while (left := self.settings.trials - len(self.trials)) > 0:
            asked = [study.ask(distributions) for _ in range(min(_BATCH, left))]
            for trial, ratio in zip(
                asked, self._try([space.round(trial.params) for trial in asked], base), strict=True
            ):
                study.tell(trial, min(ratio, _WORST))

    def _try(self, values: Sequence[dict[str, Value]], base: dict[str, float]) -> list[float]:
        """Map each log of the search with these values; returns ratios to the start."""
        settings = self.settings
        configurations = [settings.space.apply(settings.base, one) for one in values]
        losses = self._evaluate(configurations, [settings.seed], self._searched)[:, :, 0]
        ratios = np.exp(np.log(losses / [*base.values()]).mean(axis=1)).tolist()
        for one, of_logs, ratio in zip(values, losses.tolist(), ratios, strict=True):
            self.trials.append(Trial(one, dict(zip(base, of_logs, strict=True)), ratio))
        return [float(ratio) for ratio in ratios]

    def _judge(self, best: Mapping[str, Value]) -> list[Pair]:
        """Run the start and the best with seeds that the search did not use."""
        settings = self.settings
        seeds = [settings.seed + 1 + k for k in range(settings.judging_seeds)]
        losses = self._evaluate([settings.base, settings.space.apply(settings.base, best)], seeds, self.judged)
        return [
            Pair(log.name, seed, *np.log(losses[:, i, k]).tolist())
            for i, log in enumerate(self.judged)
            for k, seed in enumerate(seeds)
        ]

    def _require_base(self) -> dict[str, float]:
        """Losses of the start by log of the search.

        Raises InputError where it fails, also on a log that is held out: nothing could be compared with it.
        """
        base, seed = self.settings.base, self.settings.seed
        held_out = [log for log in self.logs if log.held_out]
        losses = {}
        for logs, of_logs in ((self._searched, seed), (held_out, seed + 1)):  # the first of the seeds that judge
            for log, loss in zip(logs, self._evaluate([base], [of_logs], logs)[0, :, 0].tolist(), strict=True):
                if not math.isfinite(loss):
                    row = self._rows[self._job(base, of_logs, log).key]
                    problem = row["message"] or row["error"]
                    raise InputError(log.path, f"the configuration that the search begins with fails: {problem}")
                losses[log.name] = loss
        return {log.name: losses[log.name] for log in self._searched}

    def _evaluate(
        self, configurations: Sequence[Configuration], seeds: Sequence[int], logs: Sequence[TunedLog]
    ) -> FloatArray:
        """Losses (configurations, logs, seeds) > 0; infinite where a run fails."""
        jobs = [
            self._job(configuration, seed, log) for configuration in configurations for log in logs for seed in seeds
        ]
        new = {job.key: job for job in jobs if job.key not in self._rows}
        if new:
            self._rows |= dict(zip(new, self.run(list(new.values())), strict=True))
        losses = [_loss_of(self._rows[job.key]) for job in jobs]
        return np.array(losses).reshape(len(configurations), len(logs), len(seeds))

    def _job(self, configuration: Configuration, seed: int, log: TunedLog) -> Job:
        settings = self.settings
        parameters = {"configuration": to_table(configuration), "seed": seed, "options": settings.options}
        key = compute_key("tune", log.digest, {**parameters, "reference": log.reference_digest})
        seeded = ("--no-history", "--seed", str(seed), "--threads", str(settings.threads))
        return Job(
            (*settings.program_options, "map", log.path, *seeded, *settings.options),
            log.path,
            f"{log.name}-{key[:16]}",
            key,
            "tune",
            dumps(configuration),
            (log.reference or log.path, *settings.evaluate_options),
        )


def load_optuna() -> Any:  # noqa: ANN401
    """Module optuna, without its log; raises MissingDependencyError where it is not installed (extra: tune)."""
    try:
        import optuna
    except ImportError:
        raise MissingDependencyError("gridslam tune", "optuna", "tune") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _loss_of(row: Mapping[str, Any]) -> float:
    if row["status"] != "done" or row["document"] is None:
        return math.inf
    scores = row["document"]["evaluation"]
    loss = next(scores[kind][figure] for kind, figure in _LOSSES.items() if kind in scores)
    return max(float(loss), 1e-12)  # logarithms are compared
