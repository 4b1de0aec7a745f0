"""gridslam evaluate."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from gridslam.cli.output import print_result
from gridslam.errors import ArgumentError, InputError
from gridslam.evaluation.self_consistency import SelfConsistency, measure_self_consistency
from gridslam.evaluation.trajectory import (
    PoseErrors,
    RelationErrors,
    absolute_errors,
    relation_errors,
    relative_errors_by_distance,
)
from gridslam.io.log import detect_log_format, open_log
from gridslam.io.trajectories import read_relations, read_tum
from gridslam.types import Trajectory

__all__ = ["EVALUATION_SCHEMA", "evaluate", "format_scores", "score_against_truth"]

EVALUATION_SCHEMA = "gridslam.evaluation/1"


def evaluate(trajectory: Path, reference: Path, distance_m: float, as_json: bool) -> None:
    """Score a trajectory against relations, against another trajectory, or against its own scans in a log."""
    if not distance_m > 0:
        raise click.ClickException(f"--distance: expected a length above 0 m, got {distance_m:g}")
    estimate = read_tum(trajectory)
    try:
        if reference.suffix == ".relations":
            relations = relation_errors(estimate, read_relations(reference))
            scores: dict[str, Any] = {"relations": asdict(relations)}
            lines = [_format_relation_errors(relations)]
        elif _is_log(reference):
            agreement = measure_self_consistency(estimate, (scan for _, scan in open_log(reference)))
            scores = {"self_consistency": asdict(agreement)}
            lines = [_format_self_consistency(agreement)]
        else:
            scores = score_against_truth(estimate, read_tum(reference), distance_m)
            lines = format_scores(scores)
    except ArgumentError as error:
        if error.argument == "distance_m":
            raise click.ClickException(str(error).replace("distance_m", "--distance", 1)) from None
        raise InputError(trajectory, f"cannot be compared with {reference}: {error}") from None
    document = {"schema": EVALUATION_SCHEMA, "trajectory": str(trajectory), "reference": str(reference), **scores}
    print_result(document, lines, as_json)


def score_against_truth(estimate: Trajectory, truth: Trajectory, distance_m: float = 1.0) -> dict[str, Any]:
    """Absolute errors after alignment, and relative ones over `distance_m` of the truth's path, as JSON values."""
    absolute = absolute_errors(estimate, truth)
    relative = relative_errors_by_distance(estimate, truth, distance_m)
    return {"ate": asdict(absolute), "rpe": {"distance_m": distance_m, **asdict(relative)}}


def format_scores(scores: dict[str, Any]) -> list[str]:
    """The scores of `score_against_truth` in words."""
    rpe = dict(scores["rpe"])
    distance_m = rpe.pop("distance_m")
    return [
        f"ATE: {_format_pose_errors(PoseErrors(**scores['ate']))} (aligned)",
        f"RPE: {_format_pose_errors(PoseErrors(**rpe))} (over {distance_m:g} m)",
    ]


def _format_pose_errors(errors: PoseErrors) -> str:
    return (
        f"{errors.trans_rmse_m:.4f} m and {errors.rot_rmse_deg:.3f} deg rms, at most {errors.trans_max_m:.4f} m and "
        f"{errors.rot_max_deg:.3f} deg, {errors.n} poses"
    )


def _format_relation_errors(errors: RelationErrors) -> str:
    return (
        f"relations: {errors.trans_mean_m:.4f} +- {errors.trans_std_m:.4f} m and {errors.rot_mean_deg:.3f} +- "
        f"{errors.rot_std_deg:.3f} deg, at most {errors.trans_max_m:.4f} m and {errors.rot_max_deg:.3f} deg, "
        f"{errors.n} relations, {errors.exact:.1%} of the poses at their exact time"
    )


def _format_self_consistency(agreement: SelfConsistency) -> str:
    return (
        f"self-consistency: {agreement.nats_per_beam:.4f} nats a beam, {agreement.beams} beams of {agreement.scans} "
        "scans (less is better, between trajectories of one log)"
    )


def _is_log(path: Path) -> bool:
    """Whether a reference holds scans; a file that cannot be read is left to the reader of trajectories."""
    try:
        detect_log_format(path)
    except InputError:
        return False
    return True
