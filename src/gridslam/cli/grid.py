"""gridslam grid."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import click

from gridslam.api.grid import GridModel, map_with_poses
from gridslam.api.grid_result import GridResult
from gridslam.cli import STARTED_S
from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.output import open_output, print_json
from gridslam.cli.progress import reading_progress
from gridslam.errors import ArgumentError
from gridslam.io.log import LogOptions, open_log
from gridslam.mapping.known_poses import Unplaced
from gridslam.pipeline import Stopwatch

__all__ = ["grid_to_folder"]


def grid_to_folder(
    log: Path,
    trajectory: Path,
    options: LogOptions,
    out: Path,
    model: GridModel,
    half_life_scans: float | None,
    resolution_m: float | None,
    laser: str | None,
    max_gap_s: float,
    no_deskew: bool,
    repair: Literal["needed", "all", "none"],
    threads: int,
    as_json: bool,
) -> None:
    """Map a log with known poses into a folder and say what came of it."""
    watch = Stopwatch(STARTED_S, 0.0)
    source = open_log(log, options)
    with open_output(out) as folder, reading_progress(lambda: source.statistics, shown=not as_json) as show:

        def on_progress() -> None:
            stop_if_interrupted()
            show()

        try:
            result = map_with_poses(
                source, trajectory, model=model, half_life_scans=half_life_scans, resolution_m=resolution_m,
                laser=laser, max_gap_s=max_gap_s, deskew=not no_deskew, repair=repair, threads=threads,
                tick=on_progress, stopwatch=watch,
            )  # fmt: skip
        except ArgumentError as error:
            option = _OPTIONS.get(error.argument, error.argument)
            raise click.ClickException(f"--{str(error).replace(error.argument, option, 1)}") from None
        document = result.write(folder)
    for warning in _warnings(result):
        click.echo(f"gridslam: {log}: {warning}", err=True)
    if as_json:
        print_json(document)
    else:
        click.echo("\n".join(_summary(document, result, out)))


_OPTIONS = {"half_life_scans": "decay", "resolution_m": "resolution", "max_gap_s": "max-gap"}


def _summary(document: dict[str, Any], result: GridResult, out: Path) -> list[str]:
    """What a person wants to know, in a few lines."""
    scans, seconds, size = document["scans"], document["time"]["wall_s"], document["map"]
    return [
        f"{result.source.name}: {scans['read']} scans, {result.log.duration_s:.0f} s",
        f"{scans['used']} scans mapped by a trajectory of {len(result.given)} poses",
        f"mapped in {seconds:.1f} s, {scans['read'] / seconds:.0f} scans/s",
        f"map, {size['width_m']:.1f} m x {size['height_m']:.1f} m: {out / 'map.png'}, {out / 'map.yaml'}",
    ]


def _warnings(result: GridResult) -> Iterator[str]:
    """What is not in the map, and what makes it doubtful."""
    log = result.log
    for fault in result.repair.says():
        yield f"{fault}: taken out before mapping (--repair none leaves it; gridslam doctor tells more)"
    yield from log.remarks
    if log.truncated:
        yield f"the log is cut off; {log.scan_count} scans were there"
    first, last = (stamp * 1e-9 for stamp in (result.given.stamps_ns.min(), result.given.stamps_ns.max()))
    reasons = {
        Unplaced.OUTSIDE: f"they lie outside the trajectory, which lasts from {first:.3f} to {last:.3f} s",
        Unplaced.GAP: f"the poses about them are more than {result.max_gap_s:g} s apart (--max-gap)",
    }
    for reason, why in reasons.items():
        if count := result.unplaced[reason]:
            yield f"{count} of {log.scan_count} scans are not mapped: {why}"
