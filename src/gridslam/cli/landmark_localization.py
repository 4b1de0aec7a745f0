"""gridslam landmarks --method ekf-localization."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gridslam.api.landmark_localization import localize_by_landmarks
from gridslam.cli import STARTED_S
from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, print_json
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.pipeline import Stopwatch

__all__ = ["localize_to_folder"]


def localize_to_folder(
    log: Path,
    out: Path,
    landmarks: Path | None,
    initial_pose: tuple[float, float, float] | None,
    unknown: bool,
    as_json: bool,
    method: str = "ekf-localization",
    particles: int | None = None,
    seed: int = 0,
) -> None:
    """Localize with known landmarks, write the results and print a summary; deterministic, without particles."""
    if particles is not None:
        raise click.ClickException(f"--particles: expected none for {method}, got {particles}")
    watch = Stopwatch(STARTED_S, 0.0)
    source = open_landmark_log(log)
    with open_output(out) as folder:
        with name_option(pose="--initial-pose"):
            result = localize_by_landmarks(
                source, landmarks, pose=initial_pose, unknown=unknown, on_progress=stop_if_interrupted, stopwatch=watch
            )
        document = result.write(folder)
    if as_json:
        print_json(document)
    else:
        click.echo("\n".join(_summary(document, out)))


def _summary(document: dict[str, Any], out: Path) -> list[str]:
    """Format the summary."""
    source_info, errors, seconds = document["input"], document["errors"], document["time"]["stages"]["solve"]["wall_s"]
    time = f", {source_info['duration_s']:.0f} s" if source_info["stamped"] else ""
    lines = [
        f"{Path(source_info['path']).name}: {source_info['steps']} steps{time}, "
        f"{source_info['observations']} observations",
        f"localized by {document['map']['landmarks']} landmarks in {seconds:.1f} s, {document['outliers']} outliers",
    ]
    if errors is not None:
        aligned = ", aligned" if errors["aligned"] else ""
        lines.append(
            f"position RMSE {errors['trans_rmse_m']:.3f} m, heading RMSE {errors['rot_rmse_deg']:.1f} degrees against "
            f"the truth{aligned}"
        )
    files = "landmarks.png", "trajectory.tum", "trajectory.csv", "run.json"
    return [*lines, f"results: {', '.join(str(out / name) for name in files)}"]
