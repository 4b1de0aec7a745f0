"""Entry of the command line: signals, exit status."""

from __future__ import annotations

import gc
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress

import click

from gridslam import __version__
from gridslam.cli.commands import gridslam
from gridslam.cli.output import handle_signals, is_interrupted
from gridslam.cli.streams import close_output, open_streams
from gridslam.errors import ConfigurationError, GridslamError, InputError

EXIT_BUG = 70
"""Exit status of an exception that nobody foresaw, as EX_SOFTWARE of sysexits.h."""

_GARBAGE_OBJECTS = 20_000
"""New ones before cycles are searched for: of the 0.18 s that the searches take of `map` on the Intel log, 0.04 s are
left. They find 600 objects in cycles, whether the log is mapped for 300 s or to its end."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns the exit status: 0 done, 1 failed, 2 bad usage or input, 70 a bug of gridslam, 130 interrupted.
    """
    gc.set_threshold(_GARBAGE_OBJECTS, *gc.get_threshold()[1:])
    open_streams()
    with handle_signals(until_exit=arguments is None):
        try:
            result = gridslam.main(arguments, prog_name="gridslam", standalone_mode=False)
            status = result if isinstance(result, int) else 0
        except BaseException as error:
            status = _report_failure(error)
        problem = close_output()
        if problem is not None and not status:
            status = _report_failure(problem)
    return status


def _report_failure(error: BaseException) -> int:
    """Print in one line why the command ended, and return its exit status."""
    if isinstance(error, SystemExit):  # click's, where whoever read the output has gone
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return _print_error("interrupted", 130)
    if isinstance(error, click.UsageError) and error.ctx is not None:
        return _print_error(f"{error.format_message()} (see {error.ctx.command_path} --help)", 2)
    if isinstance(error, click.ClickException):
        return _print_error(error.format_message(), 2)
    if isinstance(error, InputError | ConfigurationError):
        return _print_error(str(error), 2)
    if isinstance(error, BrokenPipeError):  # whoever read the output has gone
        return 1
    if isinstance(error, MemoryError):
        return _print_error(f"out of memory: {error}".removesuffix(": "), 1)
    if isinstance(error, GridslamError | OSError):
        return _print_error(str(error) or type(error).__name__, 1)
    if is_interrupted():
        return _print_error("interrupted", 130)
    return _report_bug(error)


def _report_bug(error: BaseException) -> int:
    """Print the traceback of an unexpected exception, and ask to report it."""
    click.echo("".join(traceback.format_exception(error)), nl=False, err=True)
    return _print_error(f"this is a bug of gridslam {__version__}, please report it with the lines above", EXIT_BUG)


def _print_error(problem: str, status: int) -> int:
    with suppress(OSError):  # the terminal may be gone
        print("gridslam:", " ".join(problem.split()), file=sys.stderr)
    return status
