"""Sessions on the command line: map --save and --continue, session, merge."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from gridslam.api.merging import MergeResult, merge_sessions
from gridslam.api.session import Session
from gridslam.cli.options import name_option
from gridslam.cli.output import counted, open_output, open_progress, print_result, warn
from gridslam.io.maps import write_map
from gridslam.io.sessions.drives import choose_names
from gridslam.io.sessions.session_file import read_head
from gridslam.pipeline import Stopwatch


def show_session(file: Path, out: Path | None, as_json: bool) -> None:
    """Print the content of a session file; with a folder write its maps there."""
    head = read_head(file)
    document = head.document
    groups = [*([] if document["run"] is None else [_of_run(document["run"])]), *document["pieces"]]
    names = choose_names(drives[0]["name"] for drives in groups)  # as `Session.names` has them
    logs = [log for drives in groups for drive in drives for log in drive["logs"]]
    content = {
        "schema": "gridslam.session_summary/1",
        "path": str(file),
        "bytes": file.stat().st_size,
        **{name: document[name] for name in ("version", "written", "seed", "configuration")},
        "can_go_on": document["run"] is not None,
        "maps": names,
        "pieces": groups,
        "scans": sum(log["scans"] for log in logs),
        "length_m": sum(log["length_m"] for log in logs),
        "days": len({log["first_stamp_ns"] // 86_400_000_000_000 for log in logs}),
        "key_scans": head.key_scans,
        "constraints": head.constraints,
    }
    if out is not None:
        _write_maps(Session.open(file), out)
    written = (f"map: {out / name}.yaml" for name in names if out is not None)
    print_result(content, [*_describe(content), *written], as_json)


def _of_run(run: dict[str, Any]) -> list[dict[str, Any]]:
    return [*run["earlier"], {name: run[name] for name in ("name", "logs")}]


def _write_maps(session: Session, out: Path) -> None:
    """Write the maps of a session."""
    names = session.names
    with open_output(out, [f"{name}{suffix}" for name in names for suffix in (".yaml", ".pgm")]) as folder:
        for name, grid in zip(names, session.maps, strict=True):
            write_map(folder.file(f"{name}.yaml"), grid)


def _describe(content: dict[str, Any]) -> Iterator[str]:
    days = content["days"]
    drives = sum(len(piece) for piece in content["pieces"])
    yield f"{content['path']}: {content['bytes'] / 1e6:.1f} MB, written {content['written']} by {content['version']}"
    yield (
        f"{counted(drives, 'drive')} of {counted(days, 'day')}, {counted(content['scans'], 'scan')}, "
        f"{content['length_m']:.0f} m driven, {content['key_scans']} key scans, {content['constraints']} constraints"
    )
    pieces = content["pieces"]
    for number, piece in enumerate(pieces, start=1):
        what = (
            f"the map, {content['maps'][0]}" if len(pieces) == 1 else f"piece {number}, {content['maps'][number - 1]}"
        )
        yield f"{what}: {len(piece)} drive{'s' * (len(piece) != 1)}"
        for drive in piece:
            for log in drive["logs"]:
                digest = f", SHA-256 {log['sha256'][:12]}" if log["sha256"] else ""
                yield f"  {drive['name']}: {log['path']}, {log['scans']} scans, {log['length_m']:.0f} m{digest}"
    if not content["can_go_on"]:
        yield "the filter has ended: the next log begins elsewhere"


def merge_to_folder(files: tuple[Path, ...], out: Path, save: Path | None, threads: int, as_json: bool) -> None:
    """Merge sessions, write the results to a folder and print a summary."""
    watch = Stopwatch()
    with open_output(out, MergeResult.all_names()) as folder, open_progress(shown=not as_json) as on_progress:
        with name_option(paths="FILE", others="FILE"):
            result = merge_sessions(files, threads=threads, on_progress=on_progress, stopwatch=watch)
        document = result.write(folder)
    if save is not None:
        result.session.save(save)  # where that fails the results are there
    print_result(document, _summarize_merge(result, out, save), as_json)
    if not result.is_joined:
        warn("nothing was joined: the sessions have nothing in common")
        raise click.exceptions.Exit(1)


def _summarize_merge(result: MergeResult, out: Path, save: Path | None) -> Iterator[str]:
    joined = ", ".join(result.trajectories)
    what = "one map" if result.is_joined else "a map"
    yield f"{what} of {counted(len(result.trajectories), 'drive')}: {joined}"
    for names in result.apart:
        yield f"apart, as nothing in common was found: {', '.join(names)}"
    yield f"map: {out / 'map.png'}, {out / 'map.yaml'}"
    yield f"trajectories: {out / 'trajectory.tum'}, {out / 'trajectory_NAME.tum'}"
    if save is not None:
        yield f"session: {save}"
