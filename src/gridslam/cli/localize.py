"""gridslam localize."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from gridslam.api.amcl import AMCL_DEFAULTS, AmclParameters, from_amcl, override_configuration
from gridslam.api.localization import localize
from gridslam.api.localization_result import LocalizationResult
from gridslam.cli import STARTED_S
from gridslam.cli.doctor import check_log
from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.live import live_page, observe_source
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, print_json
from gridslam.cli.progress import reading_progress
from gridslam.cli.rerun import rerun_recording
from gridslam.io.log import Log, LogOptions, open_log
from gridslam.io.maps import read_map
from gridslam.live.options import LiveOptions
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.state import LocalizationObserver, LocalizationReport, MonteCarloState
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray

if TYPE_CHECKING:
    from gridslam.live.page import LivePage
    from gridslam.viz.rerun_recording import RerunRecording

__all__ = ["localize_to_folder"]


def localize_to_folder(
    log: Path,
    map_path: Path,
    out: Path | None,
    initial_pose: tuple[float, float, float] | None,
    seed: int,
    particles: int | None,
    threads: int,
    preset: str,
    assignments: Sequence[str],
    strict_thresholds: bool,
    repair: Literal["needed", "all", "none"],
    options: LogOptions,
    live: LiveOptions | None,
    rerun: str | None,
    as_json: bool,
) -> None:
    """Localize a log in a map, write the results if a folder is given and print a summary."""
    watch = Stopwatch(STARTED_S, 0.0)
    read = _read_parameters(preset, assignments, particles)
    pose = read.pose if initial_pose is None else np.array(initial_pose)
    source = check_log(open_log(log, options), options)
    name, range_max_m, known = source.path.name, read.configuration.range_max_m, None
    if live is not None or rerun is not None:
        known = read_map(map_path, strict_thresholds=strict_thresholds)
    with ExitStack() as viewers:
        recording = viewers.enter_context(rerun_recording(rerun, name, range_max_m, known))
        page = viewers.enter_context(live_page(live, name, range_max_m, known))
        with nullcontext() if out is None else open_output(out) as folder:
            result = _localize_with_progress(
                source, map_path, pose, read, seed, threads, strict_thresholds, repair, not as_json, watch, page,
                recording,
            )  # fmt: skip
            document = result.document() if folder is None else result.write(folder)
        _print_result(document, result, read.ignored, out, as_json)


def _print_result(
    document: dict[str, Any], result: LocalizationResult, ignored: Sequence[str], out: Path | None, as_json: bool
) -> None:
    """Warnings, and the document or a summary of it."""
    for warning in _warnings(result, ignored):
        click.echo(f"gridslam: {warning}", err=True)
    if as_json:
        print_json(document)
    else:
        click.echo("\n".join(_summary(document, result, out)))


def _localize_with_progress(
    source: Log, map_path: Path, pose: FloatArray | None, read: AmclParameters, seed: int, threads: int,
    strict_thresholds: bool, repair: Literal["needed", "all", "none"], shown: bool, watch: Stopwatch,
    page: LivePage | None, recording: RerunRecording | None,
) -> LocalizationResult:  # fmt: skip
    """Localize while progress is shown, the particles on a page if there is one, and all of it recorded."""
    viewers: list[LocalizationObserver] = [] if page is None else [page.observer]
    viewers += [] if recording is None else [recording]
    if page is not None:
        page.set_progress(lambda: source.statistics.share_read)
    with reading_progress(lambda: source.statistics, shown=shown) as show:

        def observe(report: LocalizationReport, state: MonteCarloState, seconds: float) -> None:
            stop_if_interrupted()
            show()

        with name_option(pose="--initial-pose"):
            return localize(
                source, map_path, pose=pose, covariance=read.covariance, seed=seed, configuration=read.configuration,
                threads=threads, strict_thresholds=strict_thresholds, repair=repair, observers=[observe, *viewers],
                stopwatch=watch, gate=lambda source: observe_source(source, page, recording, watch),
            )  # fmt: skip


def _read_parameters(preset: str, assignments: Sequence[str], particles: int | None) -> AmclParameters:
    """Build the parameters from the preset and assignments; --particles takes precedence."""
    configuration = MonteCarloConfiguration() if preset == "default" else from_amcl(AMCL_DEFAULTS[preset]).configuration
    limits = [] if particles is None else [f"kld.particles_max={particles}"]
    if particles is not None and particles < configuration.kld.particles_min:
        limits.append(f"kld.particles_min={particles}")
    return override_configuration(configuration, [*assignments, *limits])


def _summary(document: dict[str, Any], result: LocalizationResult, out: Path | None) -> Iterator[str]:
    """Format the summary of a run."""
    scans, filter_, seconds = document["scans"], document["filter"], document["time"]["wall_s"]
    yield (
        f"{result.source.name} in {result.map_path.name}: {scans['read']} scans, {result.log.duration_s:.0f} s, "
        f"{result.driven_m[-1]:.0f} m driven"
    )
    yield (
        f"localized in {seconds:.1f} s: {scans['used']} updates of {filter_['particles_mean']:.0f} particles "
        f"on average, {filter_['inlier_ratio_mean']:.0%} of the beams agree with the map"
    )
    yield from _localization_lines(result)
    x, y, theta = result.reports[-1].pose.tolist()
    deviation = math.sqrt(float(np.trace(result.reports[-1].covariance[:2, :2])))
    yield f"at the end: x {x:.3f} m, y {y:.3f} m, theta {theta:.4f} rad, position within {deviation:.2f} m (1 sigma)"
    if out is not None:
        yield f"trajectory: {out / 'trajectory.tum'}, picture: {out / 'localization.png'}"


def _localization_lines(result: LocalizationResult) -> Iterator[str]:
    """Format the intervals in which the robot was localized or lost."""
    begin, intervals = int(result.stamps_ns[0]), result.intervals()
    for k, interval in enumerate(intervals[:_MAX_LINES]):
        after = 1e-9 * (int(result.stamps_ns[interval.first]) - begin)
        if interval.lost:
            start = "not localized at the start: poses up to the first fix are guesses"
            yield f"lost from {after:.1f} s on" if k else start
        elif k or result.pose is None:
            yield f"found after {interval.driven_m:.1f} m ({after:.1f} s)"
    if len(intervals) > _MAX_LINES:
        yield f"... {len(intervals)} intervals in total, listed in run.json"


_MAX_LINES = 8


def _warnings(result: LocalizationResult, ignored: Sequence[str]) -> Iterator[str]:
    """Yield the warnings about log, map and ignored parameters."""
    for fault in result.repair.describe():
        yield f"{result.source}: {fault}: corrected (disable with --repair none; details: gridslam doctor)"
    yield from (f"{result.map_path}: {remark} (--strict-thresholds reads literally)" for remark in result.remarks)
    if ignored:
        yield f"{', '.join(ignored)}: not supported, ignored"
    if result.lost.all():
        yield (
            f"{result.source}: the robot was never localized with confidence: the drive is too short, or the "
            "map is ambiguous"
        )
