"""gridslam map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

from gridslam.api.diagnosis import check_log, describe_finding
from gridslam.api.mapping import MapResult, map_log
from gridslam.cli import find_start_s
from gridslam.cli.live import Viewers, open_viewers
from gridslam.cli.options import MapOptions
from gridslam.cli.output import counted, open_output, open_progress, print_result
from gridslam.cli.session_options import SessionOptions
from gridslam.io.log import Log, open_log
from gridslam.live.options import LiveOptions
from gridslam.pipeline import Stopwatch


def map_to_folder(
    log: Path,
    out: Path,
    given: MapOptions,
    session: SessionOptions,
    live: LiveOptions | None,
    no_history: bool,
    as_json: bool,
) -> None:
    """Map a log, write the results to a folder and print a summary."""
    watch = Stopwatch(find_start_s(), 0.0)
    configuration = given.configuration()
    opened = session.open(configuration, given.seed, given.threads)
    if opened is not None:
        configuration = opened.configuration

    def report(text: str) -> None:
        viewers.report(text)

    source = check_log(open_log(log, given.options), given.options, report)
    with open_viewers(
        live, source.path.name, configuration.range_max_m, out=out, has_history=not no_history
    ) as viewers:
        with open_output(out, MapResult.all_names()) as folder:
            if opened is None:
                run = partial(map_log, configuration=configuration, seed=given.seed, threads=given.threads)
            else:
                run = partial(session.add, opened)
            run = partial(run, on_finding=lambda finding: report(describe_finding(source, finding)))
            result = map_with_progress(source, run, watch, viewers, shown=not as_json, repair=given.repair)
            viewers.write_history(folder)
            for warning in result.warnings():
                report(f"{log}: {warning}")
            document = result.write(folder, viewers.messages.to_list())
        if opened is not None and session.save is not None:
            opened.save(session.save)  # where that fails the results are there
        summary = summarize(document, result, out)
        print_result(document, [*summary, *session.summarize(opened, result)], as_json)


def map_with_progress(
    source: Log,
    run: Callable[..., MapResult],
    watch: Stopwatch,
    viewers: Viewers,
    *,
    shown: bool,
    repair: Literal["needed", "none"] = "none",
) -> MapResult:
    """Map a log while progress is shown, the map on a page if there is one, and all of it recorded.

    `run` maps it: `map_log` with what it needs besides, or the same of a session.
    """
    with open_progress(source, shown=shown) as on_progress:
        result = run(
            source,
            repair=repair,
            on_progress=on_progress,
            stopwatch=watch,
            keep_particles=viewers.page is not None,
            **viewers.watch(source, watch),
        )
        viewers.show_result(result)
        return result


def summarize(document: dict[str, Any], result: MapResult, out: Path) -> list[str]:
    """Format the summary of a run."""
    scans = document["scans"]
    filter_ = document["filter"]
    seconds = document["time"]["wall_s"]
    latency = document["latency"]["all_scans"]
    log = result.log
    lost = f"; lost at {counted(scans['lost'], 'scan')}" if scans["lost"] else ""
    return [
        f"{result.source.name}: {scans['read']} scans, {log.duration_s:.0f} s, {result.driven}",
        f"mapped in {seconds:.1f} s: {log.duration_s / seconds:.0f} x real time, "
        f"{scans['read'] / seconds:.0f} scans/s, {document['peak_memory_bytes'] / 1e6:.0f} MB",
        f"{counted(scans['used'], 'key scan')}, N_eff {filter_['n_eff_mean']:.1f} of {filter_['particles_mean']:.3g} "
        f"on average, resampled {counted(filter_['resamplings'], 'time')}{lost}",
        f"a scan took {1e3 * latency['median_s']:.2f} ms (median), {1e3 * latency['p99_s']:.1f} ms (99 of 100), "
        f"{1e3 * latency['max_s']:.1f} ms (longest)",
        *_summarize_loop_closure(document["loop_closure"]),
        *_summarize_pieces(result, out),
        f"map, {filter_['map_width_m']:.1f} m x {filter_['map_height_m']:.1f} m: {out / 'map.png'}, {out / 'map.yaml'}",
        f"trajectory: {out / 'trajectory.tum'}",
    ]


def _summarize_pieces(result: MapResult, out: Path) -> Iterator[str]:
    """Format where the robot was relocalized, and the pieces that stay apart."""
    found = result.found_again
    if found is not None and found.stamp_ns >= (result.log.first_stamp_ns or 0):  # else in an earlier log
        yield f"relocalized in the map of {', '.join(found.drives)} after {found.way_m:.1f} m"
    elif found is None and result.pieces:
        apart = "; ".join(", ".join(drive.name for drive in piece.drives) for piece in result.pieces)
        pieces = counted(len(result.pieces), "earlier piece")
        yield f"not found in {pieces} ({apart}), which stay apart: map_2.yaml, ..."
    if len(result.trajectories) > 1:
        yield f"trajectories of {counted(len(result.trajectories), 'drive')}: {out / 'trajectory_NAME.tum'}"


def _summarize_loop_closure(loops: dict[str, Any] | Literal[False]) -> Iterator[str]:
    """Format the loop-closure lines of the summary."""
    if not loops:
        return
    rejected = loops["rejected"]
    reasons = "; ".join(f"{reason} ({count})" for reason, count in rejected.items())
    corrections = counted(loops["corrections"], "online correction")
    moved = f"the final refinement moved key scans by up to {loops['max_correction_m']:.2f} m"
    tracked = loops["constraints"]["tracked"]
    recognized = len(loops["closures"])
    kinds = f"{recognized} recognized, {tracked} tracked"
    yield f"{counted(recognized + tracked, 'loop closure')} ({kinds}), {corrections}; {moved}"
    if rejected:
        yield f"{counted(sum(rejected.values()), 'loop-closure candidate')} rejected: {reasons}"
    if loops["sharpness_m"] is not None:
        yield f"walls seen on several visits agree within {100 * loops['sharpness_m']:.1f} cm (rms)"
    if loops["unsearched"]:
        yield f"{counted(loops['unsearched'], 'submap')} not compared with places that only a greater drift reaches"
