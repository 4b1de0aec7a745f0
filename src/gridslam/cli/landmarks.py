"""gridslam landmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gridslam.api.landmark_result import LandmarkResult
from gridslam.api.landmarks import LandmarkMethod, map_landmarks
from gridslam.cli import STARTED_S
from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.output import open_output, print_json
from gridslam.errors import ArgumentError, InputError
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.pipeline import Stopwatch

__all__ = ["landmarks_to_folder"]


def landmarks_to_folder(
    log: Path, out: Path, method: LandmarkMethod, particles: int | None, seed: int, unknown: bool, as_json: bool
) -> None:
    """Map the landmarks of a log, write the results to a folder and print a summary."""
    if method == "graph" and unknown:
        raise click.ClickException("--unknown: GraphSLAM requires known correspondences")
    watch = Stopwatch(STARTED_S, 0.0)
    source = open_landmark_log(log)
    with open_output(out) as folder:
        try:
            result = map_landmarks(
                source, method, particles=particles, seed=seed, unknown=unknown, on_progress=stop_if_interrupted,
                stopwatch=watch,
            )  # fmt: skip
        except ArgumentError as error:
            raise click.ClickException(f"--{error}") from None
        if not source.statistics.observations:
            raise InputError(log, "expected landmark observations, got none")
        document = result.write(folder)
    if as_json:
        print_json(document)
    else:
        click.echo("\n".join(_summary(document, result, out)))


def _summary(document: dict[str, Any], result: LandmarkResult, out: Path) -> list[str]:
    """Format the summary."""
    source_info, errors = document["input"], document["errors"]
    left_out = ", ".join(f"{source_info[name]} {what}" for name, what in _LEFT_OUT.items() if source_info[name])
    time = f", {source_info['duration_s']:.0f} s" if source_info["stamped"] else ""
    seconds = document["time"]["stages"]["solve"]["wall_s"]
    lines = [
        f"{Path(source_info['path']).name}: {source_info['steps']} steps{time}, "
        f"{source_info['observations']} observations" + (f" ({left_out} left out)" if left_out else ""),
        f"{document['landmarks']} landmarks by {document['method']} in {seconds:.1f} s, "
        f"{document['outliers']} outliers",
    ]
    if errors["trajectory"] is not None:
        lines.append(f"position RMSE {errors['trajectory']['trans_rmse_m']:.3f} m against the truth, aligned")
    if (found := errors["landmarks"]) is not None:
        lines.append(
            f"landmark RMSE {found['rmse_m']:.3f} m: {found['found']} found, {found['missing']} missing, "
            f"{found['surplus']} too many"
        )
    files = "landmarks.csv", "landmarks.png", "trajectory.tum", "run.json"
    return [*lines, f"results: {', '.join(str(out / name) for name in files)}"]


_LEFT_OUT = {"robots": "of other robots", "unknown": "of unknown barcodes"}
