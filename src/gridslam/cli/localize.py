"""gridslam localize."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gridslam.api.amcl import AMCL_DEFAULTS, AmclParameters, from_amcl, override_configuration, read_amcl
from gridslam.api.diagnosis import check_log
from gridslam.api.localization import LocalizationResult, localize
from gridslam.cli import find_start_s
from gridslam.cli.live import open_viewers
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, open_progress, print_result
from gridslam.io.log import LogOptions, open_log
from gridslam.io.maps import read_map
from gridslam.live.options import LiveOptions
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.pipeline import Stopwatch

_MAX_LINES = 8
"""Intervals in the summary."""


def localize_to_folder(
    log: Path,
    map_path: Path,
    out: Path | None,
    initial_pose: tuple[float, float, float] | None,
    strict_thresholds: bool,
    preset: str,
    config: Path | None,
    particles: int | None,
    assignments: Sequence[str],
    seed: int,
    threads: int,
    options: LogOptions,
    repair: Literal["needed", "none"],
    live: LiveOptions | None,
    no_history: bool,
    as_json: bool,
) -> None:
    """Localize a log in a map, write the results if a folder is given and print a summary."""
    watch = Stopwatch(find_start_s(), 0.0)
    read = read_parameters(preset, config, particles, assignments)
    how: dict[str, Any] = {
        "pose": read.pose if initial_pose is None else initial_pose,
        "covariance": read.covariance,
        "strict_thresholds": strict_thresholds,
        "configuration": read.configuration,
        "seed": seed,
        "threads": threads,
        "repair": repair,
    }
    source = check_log(open_log(log, options), options, lambda text: viewers.report(text))
    known = read_map(map_path, strict_thresholds=strict_thresholds) if live is not None else None
    with open_viewers(
        live,
        source.path.name,
        read.configuration.range_max_m,
        known,
        out=out,
        has_history=out is not None and not no_history,
    ) as viewers:
        with (
            nullcontext() if out is None else open_output(out, LocalizationResult.all_names()) as folder,
            open_progress(source, shown=not as_json) as on_progress,
            name_option(pose="--initial-pose"),
        ):
            result = localize(
                source,
                map_path,
                **how,
                on_progress=on_progress,
                stopwatch=watch,
                **viewers.watch(source, watch),
            )
            for warning in result.warnings():
                viewers.report(warning)
            if read.ignored:
                viewers.report(f"{', '.join(read.ignored)}: not supported, ignored")
            if folder is not None:
                viewers.write_history(folder)
            document = result.document() if folder is None else result.write(folder, viewers.messages.to_list())
        print_result(document, _summarize(document, result, out), as_json)


def read_parameters(
    preset: str, path: Path | None, particles: int | None, assignments: Sequence[str]
) -> AmclParameters:
    """Build the parameters from preset, file and assignments, the later ones first; --particles overrides them."""
    configuration = MonteCarloConfiguration() if preset == "default" else from_amcl(AMCL_DEFAULTS[preset]).configuration
    of_file = from_amcl({}, configuration) if path is None else read_amcl(path, configuration)
    configuration = of_file.configuration
    limits = [] if particles is None else [f"kld.particles_max={particles}"]
    if particles is not None and particles < configuration.kld.particles_min:
        limits.append(f"kld.particles_min={particles}")
    read = override_configuration(configuration, [*assignments, *limits])
    if read.pose is None:
        read = read._replace(pose=of_file.pose, covariance=of_file.covariance)
    return read._replace(ignored=(*of_file.ignored, *read.ignored))


def _summarize(document: dict[str, Any], result: LocalizationResult, out: Path | None) -> Iterator[str]:
    """Format the summary of a run."""
    scans = document["scans"]
    filter_ = document["filter"]
    seconds = document["time"]["wall_s"]
    yield (
        f"{result.source.name} in {result.map_path.name}: {scans['read']} scans, {result.log.duration_s:.0f} s, "
        f"{result.driven_m[-1]:.0f} m driven"
    )
    yield (
        f"localized in {seconds:.1f} s: {scans['used']} updates of {filter_['particles_mean']:.0f} particles "
        f"on average, {filter_['inlier_ratio_mean']:.0%} of the beams agree with the map"
    )
    yield from _summarize_intervals(result)
    x, y, theta = result.reports[-1].pose.tolist()
    deviation = math.sqrt(float(np.trace(result.reports[-1].covariance[:2, :2])))
    yield f"at the end: x {x:.3f} m, y {y:.3f} m, theta {theta:.4f} rad, position within {deviation:.2f} m (1 sigma)"
    if out is not None:
        yield f"trajectory: {out / 'trajectory.tum'}, picture: {out / 'localization.png'}"


def _summarize_intervals(result: LocalizationResult) -> Iterator[str]:
    """Format the intervals in which the robot was localized or lost."""
    since_s = 1e-9 * (result.stamps_ns - result.stamps_ns[0])
    intervals = result.intervals()
    for k, interval in enumerate(intervals[:_MAX_LINES]):
        after = since_s[interval.first]
        if interval.lost:
            start = "not localized at the start: poses up to the first fix are guesses"
            yield f"lost from {after:.1f} s on" if k else start
        elif k or result.pose is None:
            yield f"found after {interval.driven_m:.1f} m ({after:.1f} s)"
    if len(intervals) > _MAX_LINES:
        yield f"... {len(intervals)} intervals in total, listed in run.json"
