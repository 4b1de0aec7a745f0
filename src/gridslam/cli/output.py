"""Output, progress and interruption of commands; importing this module is cheap."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from gridslam.errors import OutputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from gridslam.io.log import Log
    from gridslam.io.output import OutputFolder

Display: TypeAlias = Callable[[Callable[[], tuple[float | None, str]]], None]
"""Displays the share and the text that its argument returns: see `open_display`."""

_BAR_EVERY_S = 0.25
_LINE_EVERY_S = 5.0

_SIGNALS = "SIGINT", "SIGTERM", "SIGHUP"

_interrupted = False


@contextmanager
def open_output(path: Path, names: Sequence[str] = ()) -> Iterator[OutputFolder]:
    """Open OUT for files of these names before the long work; one that cannot be written is bad usage."""
    from gridslam.io.output import OutputFolder

    with ExitStack() as stack:
        try:
            out = stack.enter_context(OutputFolder(path, names))
        except OutputError as error:
            raise click.ClickException(str(error)) from None
        yield out


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural unless it is one."""
    return f"{count} {noun}{'s' * (count != 1)}"


def print_result(document: Mapping[str, Any], summary: Iterable[str], as_json: bool) -> None:
    """Print the document of a run with --json, otherwise the lines of its summary; print failures on stderr."""
    warn(*document.get("failures", ()))
    if as_json:
        click.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        click.echo("\n".join(summary))


def warn(*warnings: str) -> None:
    """Print warnings on stderr, a line for each."""
    for warning in warnings:
        click.echo(f"gridslam: {' '.join(warning.splitlines())}", err=True)


class _Interrupted(KeyboardInterrupt):
    """A signal that has come. Where KeyboardInterrupt itself leaves `exec`, Python ends the process by SIGINT later."""


@contextmanager
def handle_signals(*, until_exit: bool = False) -> Iterator[None]:
    """Turn the first SIGINT, SIGTERM or SIGHUP into KeyboardInterrupt; later ones must not disturb the cleaning up.

    `until_exit`: when the context ends they are ignored for the rest of the process.
    """
    global _interrupted
    _interrupted = False
    numbers = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        numbers = []  # signals are handled by the main thread alone
    before = {number: signal.getsignal(number) for number in numbers}
    if until_exit:
        sys.unraisablehook = _report_unraisable
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # as SIGHUP by nohup
            signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number in before:  # the results are written, or gone
            signal.signal(number, signal.SIG_IGN if until_exit else before[number])


@contextmanager
def end_by_signal() -> Iterator[None]:
    """End a service by a signal, which is no failure; SIGINT does so also in the background of a shell (`&`).

    A shell without job control lets programs that it starts with `&` ignore SIGINT, by which ROS ends nodes.
    """
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupt)
    with suppress(KeyboardInterrupt):
        yield


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    if not _interrupted:
        _interrupted = True
        raise _Interrupted


def _report_unraisable(swallowed: sys.UnraisableHookArgs) -> None:
    """Report an exception of a destructor or callback, but for an interrupt: see `stop_if_interrupted`."""
    if not isinstance(swallowed.exc_value, _Interrupted):
        sys.__unraisablehook__(swallowed)


def is_interrupted() -> bool:
    """Return whether an interrupt has come, even where Python has converted it to a RuntimeError."""
    return _interrupted


def stop_if_interrupted() -> None:
    """Repeat an interrupt which came while a destructor ran: Python swallows it there."""
    if _interrupted:
        raise _Interrupted


@contextmanager
def open_progress(source: Log | None = None, *, shown: bool = True) -> Iterator[Callable[[], None]]:
    """Return a callback for each step: it shows their number and the share of a log, and stops if interrupted."""
    steps = 0
    with open_display(shown) as display:

        def on_progress() -> None:
            nonlocal steps
            steps += 1
            display(lambda: (None if source is None else source.statistics.share_read, counted(steps, "step")))

        yield on_progress


@contextmanager
def open_display(shown: bool) -> Iterator[Display]:
    """Yield a function that displays a share, if it is known, and a text when it is time; it stops if interrupted.

    On a terminal that is a bar, elsewhere a line. Its argument, which is not called before, returns both.
    """
    is_bar = shown and sys.stderr.isatty()
    with _make_bar() if is_bar else nullcontext() as bar:
        due = time.perf_counter() + (_BAR_EVERY_S if is_bar else _LINE_EVERY_S)

        def display(describe: Callable[[], tuple[float | None, str]]) -> None:
            nonlocal due
            stop_if_interrupted()
            now = time.perf_counter()
            if not shown or now < due:
                return
            due = now + (_BAR_EVERY_S if is_bar else _LINE_EVERY_S)
            share, text = describe()
            line = text if share is None else f"{share:4.0%}  {text}"
            if bar is not None:
                total = None if share is None else 1.0
                bar.update(bar.task_ids[0], completed=share or 0.0, total=total, description=line, refresh=True)
            else:
                print(line, file=sys.stderr, flush=True)

        yield display


def _make_bar() -> Progress:
    from rich.console import Console  # only a terminal pays for its import
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn()
    bar = Progress(*columns, console=Console(stderr=True), auto_refresh=False, transient=True)
    bar.add_task("")
    return bar
