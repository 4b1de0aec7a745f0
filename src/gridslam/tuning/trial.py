"""One trial: a log is mapped with one configuration and one seed, and the trajectory is scored."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from gridslam.api.evaluation import is_log
from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.config.tables import replace_parameters
from gridslam.doctor.repair import open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.evaluation.self_consistency import measure_self_consistency
from gridslam.evaluation.trajectory import Relations, absolute_errors, relation_errors
from gridslam.io.limits import limit_memory
from gridslam.io.log import LogOptions
from gridslam.io.trajectories import read_relations, read_trajectory
from gridslam.types import Trajectory

TARGET: Final = f"{__name__}:run_trial"
"""Target of the jobs of a tuning."""

_TOLERANCE_NS: Final = 1_000_000
"""By which `relation_errors` lets a time lie outside the trajectory."""
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
        ``loss``, less is better: with relations the mean error of the translation, over those within the time that was
        mapped, with a true trajectory the root mean square after alignment, both in m; else the self-consistency in
        nats a beam.

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
            loss = _measure_error(result.trajectory, arguments["log"], Path(arguments["reference"]))
    return {"loss": loss}


def _measure_error(trajectory: Trajectory, log: str, reference: Path) -> float:
    """Error (m) by the reference, over the part of it that the trajectory covers."""
    try:
        if reference.suffix == ".relations":
            return relation_errors(trajectory, _clip_relations(read_relations(reference), trajectory)).trans_mean_m
        if is_log(reference):
            raise InputError(reference, "expected a trajectory or relations, got a log")
        return absolute_errors(trajectory, read_trajectory(reference, trajectory.stamps_ns)).trans_rmse_m
    except ArgumentError as error:
        raise InputError(reference, f"cannot be compared with {log}: {error}") from None


def _clip_relations(relations: Relations, trajectory: Trajectory) -> Relations:
    """Relations whose times lie within the trajectory's, where the log was read in part; raises ArgumentError."""
    first, last = trajectory.stamps_ns.min() - _TOLERANCE_NS, trajectory.stamps_ns.max() + _TOLERANCE_NS
    times = np.array([relations.from_ns, relations.to_ns])
    within = ((times >= first) & (times <= last)).all(axis=0)
    if not within.any():
        raise ArgumentError("reference", "a relation within the time that was mapped", "none")
    return Relations(relations.from_ns[within], relations.to_ns[within], relations.poses[within])
