"""What calls that read a log accept as one."""

from __future__ import annotations

from pathlib import Path

from gridslam.errors import ArgumentError
from gridslam.io.log import Log, LogOptions, open_log

__all__ = ["opened_log"]


def opened_log(log: str | Path | Log, options: LogOptions | None) -> Log:
    """Open the log at a path; one that is open already has no more options (ArgumentError)."""
    if isinstance(log, str | Path):
        return open_log(log, options or LogOptions())
    if options is not None:
        raise ArgumentError("options", "none for a log that is open already", options)
    return log
