"""gridslam convert."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from gridslam.api.conversion import Conversion, convert_log, infer_format
from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.output import open_output, print_json
from gridslam.cli.progress import reading_progress
from gridslam.errors import ArgumentError
from gridslam.io.log import LogOptions, open_log

__all__ = ["CONVERSION_SCHEMA", "convert"]

CONVERSION_SCHEMA = "gridslam.conversion/1"


def convert(log: Path, out: Path, options: LogOptions, to: str | None, as_json: bool) -> None:
    """Convert a log and report the data that the target format cannot represent."""
    _check(log, out, to)
    source = open_log(log, options)
    with open_output(out.parent) as folder, reading_progress(lambda: source.statistics, shown=not as_json) as show:

        def on_progress() -> None:
            stop_if_interrupted()
            show()

        conversion = replace(convert_log(source, folder.file(out.name), to, on_progress=on_progress), out=out)
    if conversion.log.truncated:
        click.echo(f"gridslam: {log}: the log is truncated after {conversion.log.scan_count} scans", err=True)
    if conversion.lost:
        click.echo(
            f"gridslam: {out}: lost in the format {conversion.format.value}: {_describe_lost(conversion)}", err=True
        )
    if as_json:
        print_json(_document(log, conversion))
    else:
        what = "poses" if conversion.format.value == "tum" else "scans"
        click.echo(f"{log}: {conversion.log.scan_count} scans, {conversion.log.duration_s:.0f} s")
        click.echo(f"{out}: {conversion.scans} {what} in the format {conversion.format.value}")


def _check(log: Path, out: Path, to: str | None) -> None:
    """Refuse an OUT that is no name for a new log."""
    if not out.name or out.is_dir():
        raise click.ClickException(f"{out}: expected the name of a new log, got an existing folder")
    if out.exists() and log.exists() and out.samefile(log):
        raise click.ClickException(f"{out}: expected a name other than the input log")
    try:
        infer_format(out, to)
    except ArgumentError as error:
        raise click.ClickException(f"{error}; or set the format with --to") from None


def _describe_lost(conversion: Conversion) -> str:
    """What was lost; in how many scans, where it was not in all."""
    read = conversion.log.scan_count
    return ", ".join(
        what if count >= min(read, conversion.scans) else f"{what} ({count} of {read})"
        for what, count in conversion.lost.items()
    )


def _document(log: Path, conversion: Conversion) -> dict[str, Any]:
    return {
        "schema": CONVERSION_SCHEMA, "log": str(log), "out": str(conversion.out), "format": conversion.format.value,
        "scans": conversion.log.scan_count, "written": conversion.scans, "duration_s": conversion.log.duration_s,
        "lost": conversion.lost, "truncated": conversion.log.truncated,
    }  # fmt: skip
