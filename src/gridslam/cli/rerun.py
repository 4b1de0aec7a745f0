"""The option --rerun, by which commands record a run for Rerun's viewer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from gridslam.types import OccupancyGrid
    from gridslam.viz.rerun_recording import RerunRecording

__all__ = ["rerun_option", "rerun_recording"]

rerun_option = click.option(
    "--rerun", metavar="FILE|HOST:PORT", help="Record the run for Rerun's viewer, or stream it there (extra: rerun)."
)


@contextmanager
def rerun_recording(
    target: str | None, title: str, range_max_m: float, known: OccupancyGrid | None = None
) -> Iterator[RerunRecording | None]:
    """Give the recording of a run, or None where none is wanted; it is complete in the end."""
    if target is None:
        yield None
        return
    from gridslam.viz.rerun_recording import RerunRecording

    with RerunRecording(target, title, range_max_m=range_max_m, known=known) as recording:
        yield recording
