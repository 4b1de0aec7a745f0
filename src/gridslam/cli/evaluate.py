"""gridslam evaluate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gridslam.api.evaluation import evaluate_trajectory
from gridslam.cli.options import name_option
from gridslam.cli.output import print_result
from gridslam.evaluation.self_consistency import SelfConsistency
from gridslam.evaluation.trajectory import PoseErrors, RelationErrors


def evaluate(trajectory: Path, reference: Path, distance_m: float, is_part: bool, as_json: bool) -> None:
    """Score a trajectory against relations, against another trajectory, or against its own scans in a log."""
    with name_option(distance_m="--distance"):
        document = evaluate_trajectory(trajectory, reference, distance_m, is_part=is_part)
    print_result(document, format_scores(document), as_json)


def format_scores(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `evaluate_trajectory` in words."""
    if "relations" in scores:
        return [_format_relation_errors(RelationErrors(**scores["relations"]))]
    if "self_consistency" in scores:
        return _format_self_consistency(SelfConsistency(**scores["self_consistency"]))
    rpe = dict(scores["rpe"])
    distance_m = rpe.pop("distance_m")
    lines = [
        f"ATE: {_format_pose_errors(PoseErrors(**scores['ate']))} (aligned)",
        f"RPE: {_format_pose_errors(PoseErrors(**rpe))} (over {distance_m:g} m)",
    ]
    if left := scores["poses"] - scores["ate"]["n"]:
        gap = f"the reference has no poses around them that are {scores['max_gap_s']:g} s apart or less"
        lines.append(f"{left} of {scores['poses']} poses are not compared: {gap}")
    return lines


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


def _format_self_consistency(agreement: SelfConsistency) -> list[str]:
    lines = [
        f"self-consistency: {agreement.nats_per_beam:.4f} nats a beam, {agreement.beams} beams of {agreement.scans} "
        "scans (less is better, between trajectories of one log)"
    ]
    if agreement.sharpness_m is not None:
        lines.append(f"walls seen on several visits agree within {100 * agreement.sharpness_m:.1f} cm (rms)")
    return lines
