"""One trial: a log is mapped with one configuration and one seed, and the trajectory is scored."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gridslam.api.evaluation import score_against_reference
from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.config.tables import replace_parameters
from gridslam.doctor.repair import open_repaired
from gridslam.evaluation.self_consistency import measure_self_consistency
from gridslam.io.limits import limit_memory
from gridslam.io.log import LogOptions

TARGET: Final = f"{__name__}:run_trial"
"""Target of the jobs of a tuning."""

_BESIDE: Final = (".relations", ".truth.tum", ".ref.tum", ".ref.tum.gz")


def find_reference(log: str | Path) -> Path | None:
    """File beside a log that has its name and is a reference: NAME.relations, NAME.truth.tum or NAME.ref.tum[.gz]."""
    path = Path(log)
    stem = path.name.partition(".")[0]
    return next((found for ending in _BESIDE if (found := path.with_name(stem + ending)).is_file()), None)


def run_trial(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Map a log and score the trajectory.

    Parameters
    ----------
    arguments : mapping
        ``log``, its path, and ``digest``, its SHA-256; ``configuration``, a table of parameters; ``seed``, ``threads``,
        ``repair``; ``options``, the fields of `LogOptions`; ``reference``, a file of relations (.relations) or a true
        trajectory, or None; ``max_memory_bytes``.

    Returns
    -------
    dict
        ``loss``, less is better: with relations the mean error of the translation, with a true trajectory the root mean
        square after alignment, both in m; else the self-consistency in nats a beam.

    Raises
    ------
    InputError
        The log or the reference cannot be read, or they have no time in common.
    """
    with limit_memory(arguments["max_memory_bytes"]):
        options = LogOptions.from_dict(arguments["options"])
        result = map_log(
            arguments["log"],
            configuration=replace_parameters(Configuration(), arguments["configuration"]),
            seed=arguments["seed"],
            options=options,
            repair=arguments["repair"],
            threads=arguments["threads"],
            digest=arguments["digest"],
            keep_particles=False,
        )
        if arguments["reference"] is None:
            scans = (scan for _, scan in open_repaired(arguments["log"], options, arguments["repair"]))
            loss = measure_self_consistency(result.trajectory, scans).nats_per_beam
        else:
            scores = score_against_reference(result.trajectory, arguments["log"], arguments["reference"])
            loss = scores["relations"]["trans_mean_m"] if "relations" in scores else scores["ate"]["trans_rmse_m"]
    return {"loss": loss}
