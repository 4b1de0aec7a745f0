"""gridslam landmarks: mapping of landmarks, and localization by them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import click

from gridslam.api.landmark_localization import localize_by_landmarks
from gridslam.api.landmarks import LandmarkMethod, ResultByLandmarks, map_landmarks
from gridslam.cli import find_start_s
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, open_progress, print_result
from gridslam.errors import InputError
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.pipeline import Stopwatch

_LEFT_OUT = {"robots": "of other robots", "unknown": "of unknown barcodes"}


def landmarks_to_folder(
    log: Path,
    out: Path,
    method: LandmarkMethod | Literal["ekf-localization"] = "fastslam2",
    landmarks: Path | None = None,
    initial_pose: tuple[float, float, float] | None = None,
    unknown: bool = False,
    particles: int | None = None,
    seed: int = 0,
    as_json: bool = False,
) -> None:
    """Estimate the landmarks of a log, or the robot's way in a map of them, write the results and print a summary."""
    run: Callable[..., ResultByLandmarks]
    if method == "ekf-localization":
        if particles is not None:
            raise click.ClickException(f"--particles: expected none for {method}, got {particles}")
        run = partial(localize_by_landmarks, landmarks=landmarks, pose=initial_pose)
        summarize = _summarize_localization
    else:
        if landmarks is not None or initial_pose is not None:
            raise click.ClickException("--landmarks and --initial-pose: only valid with --method ekf-localization")
        if method == "graph" and unknown:
            raise click.ClickException("--unknown: GraphSLAM requires known correspondences")
        run = partial(map_landmarks, method=method, particles=particles, seed=seed)
        summarize = _summarize_map
    watch = Stopwatch(find_start_s(), 0.0)
    source = open_landmark_log(log)
    with (
        open_output(out, ResultByLandmarks.all_names()) as folder,
        name_option(particles="--particles", pose="--initial-pose"),
        open_progress(shown=not as_json) as on_progress,
    ):
        result = run(source, unknown=unknown, on_progress=on_progress, stopwatch=watch)
        if not source.statistics.observations:
            raise InputError(log, "expected landmark observations, got none")
        document = result.write(folder)
    print_result(document, summarize(document, out), as_json)


def _summarize_map(document: dict[str, Any], out: Path) -> list[str]:
    source = document["input"]
    errors = document["errors"]
    left_out = ", ".join(f"{source[name]} {what}" for name, what in _LEFT_OUT.items() if source[name])
    seconds = document["time"]["stages"]["solve"]["wall_s"]
    lines = [
        _summarize_input(source) + (f" ({left_out} left out)" if left_out else ""),
        f"{document['landmarks']} landmarks by {document['method']} in {seconds:.1f} s, "
        f"{document['outliers']} outliers",
    ]
    if errors["trajectory"] is not None:
        lines.append(f"position RMSE {errors['trajectory']['trans_rmse_m']:.3f} m against the truth, aligned")
    found = errors["landmarks"]
    if found is not None:
        lines.append(
            f"landmark RMSE {found['rmse_m']:.3f} m: {found['found']} found, {found['missing']} missing, "
            f"{found['surplus']} too many"
        )
    elif errors["trajectory"] is not None:
        lines.append("landmark RMSE: none, since no landmark is near a true one, however the map is aligned")
    return [*lines, _list_files(out, "landmarks.csv", "landmarks.png", "trajectory.tum", "run.json")]


def _summarize_localization(document: dict[str, Any], out: Path) -> list[str]:
    errors = document["errors"]
    seconds = document["time"]["stages"]["solve"]["wall_s"]
    lines = [
        _summarize_input(document["input"]),
        f"localized by {document['map']['landmarks']} landmarks in {seconds:.1f} s, {document['outliers']} outliers",
    ]
    if errors is not None:
        aligned = ", aligned" if errors["aligned"] else ""
        lines.append(
            f"position RMSE {errors['trans_rmse_m']:.3f} m, heading RMSE {errors['rot_rmse_deg']:.1f} degrees against "
            f"the truth{aligned}"
        )
    return [*lines, _list_files(out, "landmarks.png", "trajectory.tum", "trajectory.csv", "run.json")]


def _summarize_input(source: dict[str, Any]) -> str:
    time = f", {source['duration_s']:.0f} s" if source["stamped"] else ""
    return f"{Path(source['path']).name}: {source['steps']} steps{time}, {source['observations']} observations"


def _list_files(out: Path, *names: str) -> str:
    return f"results: {', '.join(str(out / name) for name in names)}"
