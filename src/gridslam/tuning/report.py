"""Files of a tuning: the configuration with its verdict, and a JSON document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Final

from gridslam import __version__
from gridslam.config import PARAMETERS, dumps
from gridslam.config.tables import value_of
from gridslam.parameters import to_table
from gridslam.tuning.comparison import CONFIDENCE, Comparison
from gridslam.tuning.tune import Settings, TunedLog, Tuning

TUNING_SCHEMA: Final = "gridslam.tuning/4"


def describe_verdict(tuning: Tuning, logs: Sequence[TunedLog]) -> list[str]:
    """State in plain lines whether the best is recommended, and the reason."""
    if tuning.comparison is None:
        tried = len({tuple(trial.values.items()) for trial in tuning.trials})
        few = [f"{tried} trials are too few to exclude a gain: {tuning.enough} or more are advised"]
        verdict = "no gain: nothing that was tried is better than the configuration that the search began with"
        return [verdict, *(few if tried < tuning.enough else [])]
    found = tuning.comparison
    where = "held-out logs" if any(log.held_out for log in logs) else "logs of the search, with other seeds"
    runs = f"{found.observations} {where}" if found.units == "logs" else f"{found.observations} runs on {where}"
    interval = f"{100 * CONFIDENCE:g} % interval {found.lower:.3f} to {found.upper:.3f}"
    measured = f"the error of the best is {found.ratio:.3f} times that of the start ({interval}, {runs})"
    if tuning.gains:
        changed = ", ".join(f"{name} {str(value).lower()}" for name, value in tuning.best.values.items())
        return [f"gain: {measured}", f"values: {changed}"]
    failed = f"; {found.failed} of its runs failed" if found.failed else ""
    return [f"no gain: {measured}{failed}", "the configuration that the search began with is kept"]


def to_toml(tuning: Tuning, logs: Sequence[TunedLog]) -> str:
    """Text for --config: the configuration to use, with the verdict as comments."""
    lines = [f"# {line}" for line in describe_verdict(tuning, logs)]
    return "\n".join([f"# gridslam tune, version {__version__}", *lines, "", dumps(tuning.configuration)])


def to_document(tuning: Tuning, settings: Settings, logs: Sequence[TunedLog], trials: int) -> dict[str, Any]:
    """JSON object of a tuning; the same logs, settings and number of trials give the same one."""
    return {
        "schema": TUNING_SCHEMA,
        "version": __version__,
        "seed": settings.seed,
        "trials_planned": trials,
        "logs": [
            {
                "name": log.name,
                "path": log.path,
                "sha256": log.digest,
                "held_out": log.held_out,
                "score": "self-consistency" if log.reference is None else "reference",
                "reference": log.reference,
            }
            for log in logs
        ],
        "searched": [
            {"name": one.name, **one.search._asdict(), "start": value_of(settings.base, PARAMETERS[one.name].path)}
            for one in settings.space.dimensions
        ],
        "start": to_table(settings.base),
        "recommended": tuning.gains,
        "verdict": describe_verdict(tuning, logs),
        "comparison": _describe_comparison(tuning.comparison),
        "pairs": [
            {"log": pair.log, "seed": pair.seed, "start": _loss(pair.base), "compared": _loss(pair.tuned)}
            for pair in tuning.pairs
        ],
        "best": tuning.best.values,
        "configuration": to_table(tuning.configuration),
        "trials": [
            {
                **asdict(trial),
                "losses": {name: _finite(loss) for name, loss in trial.losses.items()},
                "ratio": _finite(trial.ratio),
            }
            for trial in tuning.trials
        ],
    }


def _describe_comparison(found: Comparison | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {name: _finite(value) if isinstance(value, float) else value for name, value in asdict(found).items()}


def _loss(logarithm: float) -> float | None:
    return _finite(math.exp(logarithm))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
