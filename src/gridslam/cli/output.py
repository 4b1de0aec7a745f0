"""Output, progress and interruption of commands; importing this module is cheap."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, final

import click

from gridslam.errors import OutputError
from gridslam.types import describe_duration

if TYPE_CHECKING:
    from gridslam.io.log_statistics import LogStatistics
    from gridslam.io.output import OutputFolder
    from gridslam.slam.grid_fastslam.state import GridFastSlamState
    from gridslam.types import StepReport

Display: TypeAlias = Callable[[Callable[[float], tuple[float | None, str]]], float]
"""Displays the fraction and the text that its argument returns: see `open_display`."""

TARGETS: Final = "gridslam.targets"
"""Where a context of click has the targets that options name."""

_BAR_EVERY_S = 0.25
_LINE_EVERY_S = 5.0

_SIGNALS = "SIGINT", "SIGTERM", "SIGHUP"

_interrupted = False
_held = False


@contextmanager
def open_output(path: Path, names: Sequence[str] = ()) -> Iterator[OutputFolder]:
    """Open OUT for files of these names before the long work; one that cannot be written is bad usage."""
    from gridslam.io.output import OutputFolder

    context = click.get_current_context(silent=True)
    targets = {} if context is None else context.meta.get(TARGETS, {})
    for name in names:
        if Path(os.path.realpath(path / name)) in targets:
            raise click.ClickException(
                f"{path / name}: expected the place of a result alone, but an option names it, too"
            )
    with ExitStack() as stack:
        try:
            with hold_interrupts():  # until the temporary folder is certain to be removed
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


@contextmanager
def write_apart() -> Iterator[Callable[..., bool]]:
    """Return a function that writes one of several targets, and returns whether it succeeded.

    Where it could not that is reported at once, the command continues with the other targets, and fails in the end.
    """
    is_complete = True

    def write(function: Callable[..., object], *arguments: Any) -> bool:  # noqa: ANN401
        nonlocal is_complete
        try:
            function(*arguments)
        except (OutputError, OSError) as error:
            warn(str(error))
            is_complete = False
            return False
        return True

    yield write
    if not is_complete:
        raise click.exceptions.Exit(1)


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


@contextmanager
def report_background_failures(report: Callable[[BaseException], object]) -> Iterator[None]:
    """Report exceptions of other threads and of destructors instead of printing their tracebacks.

    An interrupt that comes in a destructor is not reported: `stop_if_interrupted` repeats it.
    """
    hooks = sys.unraisablehook, threading.excepthook

    def on_failure(failure: Any) -> None:  # noqa: ANN401
        if failure.exc_value is not None and not isinstance(failure.exc_value, KeyboardInterrupt | SystemExit):
            report(failure.exc_value)

    sys.unraisablehook = threading.excepthook = on_failure
    try:
        yield
    finally:
        sys.unraisablehook, threading.excepthook = hooks


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    if not _interrupted:
        _interrupted = True
        if not _held:
            raise _Interrupted


@contextmanager
def hold_interrupts() -> Iterator[None]:
    """Let an interrupt wait until the context ends."""
    global _held
    _held = True
    try:
        yield
    finally:
        _held = False
    stop_if_interrupted()


def is_interrupted() -> bool:
    """Return whether an interrupt has come, even where Python has converted it to a RuntimeError."""
    return _interrupted


def stop_if_interrupted() -> None:
    """Repeat an interrupt which came while a destructor ran: Python swallows it there."""
    if _interrupted:
        raise _Interrupted


@contextmanager
def mapping_progress(statistics: Callable[[], LogStatistics], *, shown: bool = True) -> Iterator[Progress]:
    """Yield the progress of a mapping run, which prints nothing if disabled."""
    with open_display(shown) as display:
        yield Progress(statistics, display)


@contextmanager
def elapsed_progress(what: str, *, shown: bool = True) -> Iterator[Callable[[], None]]:
    """Return a callback that shows the elapsed time where no progress is known, and stops if interrupted."""
    with open_display(shown) as display:
        yield _count(display, lambda steps, passed_s: (None, f"{what}: {counted(steps, 'step')} in {passed_s:.0f} s"))


def _count(display: Display, describe: Callable[[int, float], tuple[float | None, str]]) -> Callable[[], None]:
    """Return a callback that counts steps and displays the description of their number and the time so far."""
    steps = 0

    def on_progress() -> None:
        nonlocal steps
        steps += 1
        display(lambda passed_s: describe(steps, passed_s))

    return on_progress


@contextmanager
def reading_progress(statistics: Callable[[], LogStatistics], *, shown: bool = True) -> Iterator[Callable[[], None]]:
    """Return a callback for each scan that periodically shows the progress of reading, and stops if interrupted."""
    with open_display(shown) as display:
        yield _count(
            display,
            lambda scans, passed_s: (statistics().share_read, f"{scans} scans, {scans / passed_s:.0f}/s"),
        )


@final
class Progress:
    """Observer that periodically shows rate, N_eff, map size and remaining time, or the final refinement."""

    def __init__(self, statistics: Callable[[], LogStatistics], display: Display) -> None:
        """Begin with no scan."""
        self._statistics = statistics
        self._display = display
        self._ended_s = math.inf
        self._scans = 0
        self._first_ns = 0
        self._n_eff = 0.0
        self._latest: tuple[StepReport, GridFastSlamState] | None = None

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Record one scan."""
        self._first_ns = self._first_ns if self._scans else report.stamp_ns
        self._scans += 1
        if report.skipped is None:
            self._n_eff = report.n_eff
        self._latest = report, state

    def on_progress(self) -> None:
        """Show the progress of the scan since the last call, or of the final refinement; stop if interrupted."""
        latest = self._latest
        self._latest = None
        passed_s = self._display(partial(self._describe, latest))
        if latest is None:
            self._ended_s = min(self._ended_s, passed_s)

    def _describe(self, latest: tuple[StepReport, GridFastSlamState] | None, passed_s: float) -> tuple[float, str]:
        if latest is None:
            return 1.0, f"{self._scans} scans; final refinement, {max(passed_s - self._ended_s, 0):.0f} s"
        report, state = latest
        share = self._statistics().share_read
        height, width = state.maps.tiled(state.best).shape
        side = state.maps.resolution_m
        real = (report.stamp_ns - self._first_ns) * 1e-9 / passed_s
        left = f"{describe_duration(round(passed_s * (1 - share) / share))} left" if share else ""
        return (
            share,
            f"{self._scans} scans, {self._scans / passed_s:.0f}/s, {real:.0f} x real time, "
            f"N_eff {self._n_eff:.1f} of {len(state.poses)}, "
            f"map {width * side:.0f} x {height * side:.0f} m, {state.maps.nbytes / 1e6:.0f} MB, {left}",
        )


@contextmanager
def open_display(shown: bool) -> Iterator[Display]:
    """Yield a function that displays a fraction, if it is known, and a text when it is time; it stops if interrupted.

    Its argument, which is not called before, returns both by the time passed so far, s; so does the function itself.
    """
    with ExitStack() as stack:
        show: Callable[[float | None, str], None] = _print_line
        every_s = _LINE_EVERY_S if shown else math.inf
        if shown and sys.stderr.isatty():
            show = stack.enter_context(_bar())
            every_s = _BAR_EVERY_S
        began = time.perf_counter()
        due = began + every_s

        def display(describe: Callable[[float], tuple[float | None, str]]) -> float:
            nonlocal due
            stop_if_interrupted()
            now = time.perf_counter()
            if now >= due:
                due = now + every_s
                show(*describe(now - began))
            return now - began

        yield display


def _print_line(share: float | None, text: str) -> None:
    print(_begin_line(share) + text, file=sys.stderr, flush=True)


def _begin_line(share: float | None) -> str:
    return "" if share is None else f"{share:4.0%}  "


@contextmanager
def _bar() -> Iterator[Callable[[float | None, str], None]]:
    from rich.console import Console, Group  # only terminals pay for its import
    from rich.live import Live
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    def shown(share: float | None, text: str) -> Group:
        bar = ProgressBar(total=None if share is None else 1.0, completed=share or 0.0, width=60)
        return Group(bar, Text("\n" + _begin_line(share).lstrip() + text))

    with Live(shown(0.0, ""), console=Console(stderr=True), auto_refresh=False, transient=True) as live:
        yield lambda share, text: live.update(shown(share, text), refresh=True)
