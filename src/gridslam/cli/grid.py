"""gridslam grid."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from gridslam.api.grid import GridModel, GridResult, map_with_poses
from gridslam.cli import find_start_s
from gridslam.cli.options import name_option
from gridslam.cli.output import counted, open_output, open_progress, print_result, warn
from gridslam.io.log import LogOptions, open_log
from gridslam.mapping.known_poses import NoPoseReason
from gridslam.pipeline import Stopwatch


def grid_to_folder(
    log: Path,
    trajectory: Path,
    out: Path,
    model: GridModel,
    max_gap_s: float,
    no_deskew: bool,
    resolution_m: float | None,
    laser: str | None,
    threads: int,
    options: LogOptions,
    repair: Literal["needed", "none"],
    as_json: bool,
) -> None:
    """Map a log with known poses, write the results to a folder and print a summary."""
    watch = Stopwatch(find_start_s(), 0.0)
    source = open_log(log, options)
    with (
        open_output(out, GridResult.all_names()) as folder,
        open_progress(source, shown=not as_json) as on_progress,
        name_option(resolution_m="--resolution", max_gap_s="--max-gap"),
    ):
        result = map_with_poses(
            source,
            trajectory,
            model=model,
            max_gap_s=max_gap_s,
            deskew=not no_deskew,
            resolution_m=resolution_m,
            laser=laser,
            threads=threads,
            repair=repair,
            on_progress=on_progress,
            stopwatch=watch,
        )
        document = result.write(folder)
    warn(*(f"{log}: {warning}" for warning in _find_warnings(result)))
    print_result(document, _summarize(document, result, out), as_json)


def _summarize(document: dict[str, Any], result: GridResult, out: Path) -> list[str]:
    """Format the summary."""
    scans = document["scans"]
    seconds = document["time"]["wall_s"]
    size = document["map"]
    return [
        f"{result.source.name}: {scans['read']} scans, {result.log.duration_s:.0f} s",
        f"{counted(scans['used'], 'scan')} mapped by a trajectory of {len(result.given)} poses",
        f"mapped in {seconds:.1f} s, {scans['read'] / seconds:.0f} scans/s",
        f"map, {size['width_m']:.1f} m x {size['height_m']:.1f} m: {out / 'map.png'}, {out / 'map.yaml'}",
    ]


def _find_warnings(result: GridResult) -> Iterator[str]:
    """Yield the warnings about unmapped scans and the log."""
    yield from result.describe_faults()
    first = result.given.stamps_ns.min() * 1e-9
    last = result.given.stamps_ns.max() * 1e-9
    reasons = {
        NoPoseReason.OUTSIDE: f"they lie outside the trajectory, which lasts from {first:.3f} to {last:.3f} s",
        NoPoseReason.GAP: f"the neighbouring poses are more than {result.max_gap_s:g} s apart (--max-gap)",
    }
    for reason, why in reasons.items():
        if count := result.unplaced[reason]:
            yield f"{count} of {result.log.scan_count} scans are not mapped: {why}"
