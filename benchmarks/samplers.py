"""The search of `gridslam tune` against other samplers, at equal cost, on a noisy function of known minimum.

Needs Optuna, which gridslam does not: ``pip install optuna``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.tuning.evolution import evolve
from gridslam.tuning.halving import halve, plan_rungs
from gridslam.types import FloatArray
from measure import write_document

__all__ = ["main", "search", "toy"]

_DIMENSIONS = 12  # as many as gridslam tunes
_SEEDS = 15
_NOISE = 0.03  # of a whole log; of a part it is larger
_TRIALS = 40, 60, 150


def toy(seed: int) -> tuple[Callable[[FloatArray], float], Callable[[FloatArray, float], float]]:
    """A quadratic some of whose dimensions matter much more than others, without and with noise."""
    rng = np.random.default_rng(seed)
    target = rng.uniform(0.15, 0.85, _DIMENSIONS)
    weights = rng.exponential(1, _DIMENSIONS) ** 2
    weights /= weights.sum()
    noise = np.random.default_rng([seed, 1])

    def true(point: FloatArray) -> float:
        return 6 * float((weights * (point - target) ** 2).sum())

    return true, lambda point, part: true(point) + _NOISE / np.sqrt(part) * noise.standard_normal()


def search(seed: int, trials: int) -> tuple[float, float]:
    """True loss of what halving and CMA-ES find from the middle, and what they cost, in whole logs."""
    true, noisy = toy(seed)
    rungs = plan_rungs(trials // 2)
    count = rungs[0].candidates
    rng = np.random.default_rng([seed, 2])
    points = (
        np.array([rng.permutation(count) for _ in range(_DIMENSIONS)]).T + rng.random((count, _DIMENSIONS))
    ) / count
    points[0] = 0.5
    found = list[tuple[float, FloatArray]]()

    def evaluate(some: Sequence[FloatArray], part: float) -> list[float]:
        losses = [noisy(point, part) for point in some]
        found.extend(zip(losses, some, strict=True) if part == 1 else ())
        return losses

    start = halve(list(points), rungs, evaluate)[0][0]
    evolved = evolve(start, trials - count, lambda some: evaluate(list(some), 1.0), seed=seed)
    cost = sum(rung.candidates * rung.part for rung in rungs) + len(evolved)
    return true(min(found, key=lambda one: one[0])[1]), cost


def _by_optuna(seed: int, trials: int, sampler: Any) -> float:  # noqa: ANN401
    """The same by a sampler of Optuna, on whole logs, from the middle."""
    import optuna

    true, noisy = toy(seed)
    study = optuna.create_study(sampler=sampler)
    names = [f"x{k}" for k in range(_DIMENSIONS)]
    study.enqueue_trial(dict.fromkeys(names, 0.5))
    study.optimize(lambda trial: noisy(np.array([trial.suggest_float(name, 0, 1) for name in names]), 1.0), trials)
    return true(np.array([study.best_params[name] for name in names]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare and write the medians."""
    import optuna

    parser = argparse.ArgumentParser(description="Samplers at equal cost on a noisy quadratic.")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/samplers.json"))
    out = parser.parse_args(arguments).out
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    rows = []
    for trials in _TRIALS:
        ours = [search(seed, trials) for seed in range(_SEEDS)]
        cost = round(float(np.mean([one[1] for one in ours])))
        tpe = [
            _by_optuna(seed, cost, optuna.samplers.TPESampler(seed=seed, multivariate=True)) for seed in range(_SEEDS)
        ]
        chance = [_by_optuna(seed, cost, optuna.samplers.RandomSampler(seed=seed)) for seed in range(_SEEDS)]
        medians = {
            "halving and CMA-ES": float(np.median([one[0] for one in ours])),
            "TPE (Optuna)": float(np.median(tpe)),
            "random": float(np.median(chance)),
            "start": float(np.median([toy(seed)[0](np.full(_DIMENSIONS, 0.5)) for seed in range(_SEEDS)])),
        }
        rows.append({"trials": trials, "whole_logs": cost, "median_loss": medians})
        print(rows[-1], flush=True)
    write_document(out, f"python benchmarks/samplers.py; Optuna {optuna.__version__}, {_SEEDS} seeds", rows=rows)


if __name__ == "__main__":
    main()
