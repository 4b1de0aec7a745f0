"""Scores of a trajectory against relations, another trajectory or its own scans, as JSON values."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from gridslam.doctor.repair import open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.evaluation.self_consistency import measure_self_consistency
from gridslam.evaluation.trajectory import (
    MAX_GAP_NS,
    absolute_errors,
    clip_relations,
    relation_errors,
    relative_errors_by_distance,
)
from gridslam.io.log import detect_log_format
from gridslam.io.trajectories import read_relations, read_trajectory
from gridslam.types import Trajectory

EVALUATION_SCHEMA = "gridslam.evaluation/1"


def evaluate_trajectory(
    trajectory: str | Path, reference: str | Path, distance_m: float = 1.0, *, is_part: bool = False
) -> dict[str, Any]:
    """Score a trajectory file against relations, against another trajectory, or against its own scans.

    Parameters
    ----------
    trajectory : str or Path
        A file in TUM or EuRoC format.
    reference : str or Path
        True relations if its name ends in .relations; the log that the trajectory is of, in any format, read with the
        corrections of `map_log`; or else the true trajectory, a file in TUM or EuRoC format.
    distance_m : float, m, > 0
        Path length between the pairs of poses of the RPE.
    is_part : bool
        Whether the trajectory is of a part of the log: only relations within its time are scored.

    Returns
    -------
    dict
        The document of `gridslam evaluate`: ``relations``, ``self_consistency``, or ``ate`` and ``rpe``.

    Raises
    ------
    ArgumentError
        `distance_m` is out of range.
    InputError
        A file cannot be read, or the two have no times in common.
    """
    estimate = read_trajectory(trajectory)
    try:
        scores = _score(estimate, reference, distance_m, is_part)
    except ArgumentError as error:
        if error.argument == "distance_m":
            raise
        raise InputError(trajectory, f"cannot be compared with {reference}: {error}") from None
    return {"schema": EVALUATION_SCHEMA, "trajectory": str(trajectory), "reference": str(reference), **scores}


def _score(estimate: Trajectory, reference: str | Path, distance_m: float, is_part: bool) -> dict[str, Any]:
    if Path(reference).suffix == ".relations":
        relations = read_relations(reference)
        relations = clip_relations(relations, estimate) if is_part else relations
        return {"relations": asdict(relation_errors(estimate, relations))}
    if is_log(reference):
        scans = (scan for _, scan in open_repaired(reference, None, "needed"))
        return {"self_consistency": asdict(measure_self_consistency(estimate, scans))}
    return score_against_truth(estimate, read_trajectory(reference), distance_m)


def score_against_truth(estimate: Trajectory, truth: Trajectory, distance_m: float = 1.0) -> dict[str, Any]:
    """Return absolute errors after alignment, and relative ones over `distance_m` of the truth's path, as JSON values.

    Also how many poses the estimate has, of which those without partner do not count, and up to which gap between its
    poses the truth was interpolated.
    """
    absolute = absolute_errors(estimate, truth)
    relative = relative_errors_by_distance(estimate, truth, distance_m)
    return {
        "ate": asdict(absolute),
        "rpe": {"distance_m": distance_m, **asdict(relative)},
        "poses": len(estimate),
        "max_gap_s": MAX_GAP_NS / 1e9,
    }


def is_log(path: str | Path) -> bool:
    """Return whether a reference holds scans; a file that cannot be read is left to the reader of trajectories."""
    try:
        detect_log_format(path)
    except InputError:
        return False
    return True
