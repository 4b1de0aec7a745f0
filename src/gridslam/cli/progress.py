"""Progress on stderr: a bar on a terminal, otherwise one line every few seconds."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import final

from gridslam.io.log_statistics import LogStatistics
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import StepReport

__all__ = ["Progress", "progress", "reading_progress"]

_BAR_EVERY_S, _LINE_EVERY_S = 0.25, 5.0


@contextmanager
def progress(statistics: Callable[[], LogStatistics], *, shown: bool = True) -> Iterator[Progress]:
    """Yield the progress observer of a mapping run; it prints nothing if disabled."""
    with _display(shown) as (show, every_s):
        yield Progress(statistics, show, every_s)


@contextmanager
def reading_progress(statistics: Callable[[], LogStatistics], *, shown: bool = True) -> Iterator[Callable[[], None]]:
    """Give what is called after each scan and shows how far the reading of a log has come, now and then."""
    with _display(shown) as (show, every_s):
        began, scans = time.perf_counter(), 0
        due = began + every_s

        def on_scan() -> None:
            nonlocal scans, due
            scans += 1
            if (now := time.perf_counter()) >= due:
                due = now + every_s
                show(statistics().share_read, f"{scans} scans, {scans / (now - began):.0f}/s")

        yield on_scan


@contextmanager
def _display(shown: bool) -> Iterator[tuple[Callable[[float, str], None], float]]:
    """Yield a function that displays a fraction and a text, and its period in seconds."""
    if not shown:
        yield lambda share, text: None, math.inf
    elif sys.stderr.isatty():
        with _bar() as show:
            yield show, _BAR_EVERY_S
    else:
        yield _print_line, _LINE_EVERY_S


def _print_line(share: float, text: str) -> None:
    print(f"{share:4.0%}  {text}", file=sys.stderr, flush=True)


@contextmanager
def _bar() -> Iterator[Callable[[float, str], None]]:
    from rich.console import Console, Group  # only terminals pay for its import
    from rich.live import Live
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    def shown(share: float, text: str) -> Group:
        return Group(ProgressBar(total=1.0, completed=share, width=60), Text(f"\n{share:.0%}  {text}"))

    with Live(shown(0.0, ""), console=Console(stderr=True), auto_refresh=False, transient=True) as live:
        yield lambda share, text: live.update(shown(share, text), refresh=True)


@final
class Progress:
    """Observer that periodically shows rate, N_eff, map size and time left.

    After the last scan `show_refinement` shows that the run is still working.
    """

    def __init__(
        self, statistics: Callable[[], LogStatistics], show: Callable[[float, str], None], every_s: float
    ) -> None:
        """Display a fraction (0 to 1) and a text with `show`, at the given period in seconds."""
        self._statistics, self._show, self._every_s = statistics, show, every_s
        self._began, self._ended = time.perf_counter(), math.inf
        self._due = self._began + every_s
        self._scans, self._n_eff, self._first_ns = 0, 0.0, 0

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Show the progress after one scan."""
        self._first_ns = self._first_ns if self._scans else report.stamp_ns
        self._scans += 1
        if report.skipped is None:
            self._n_eff = report.n_eff
        if (now := time.perf_counter()) >= self._due:
            self._due = now + self._every_s
            self._show_rate(now - self._began, report, state)

    def show_refinement(self) -> None:
        """Periodically show the elapsed time of the final refinement."""
        now = time.perf_counter()
        self._ended = min(self._ended, now)
        if now >= self._due:
            self._due = now + self._every_s
            self._show(1.0, f"{self._scans} scans; final refinement, {now - self._ended:.0f} s")

    def _show_rate(self, seconds: float, report: StepReport, state: GridFastSlamState) -> None:
        log = self._statistics()
        share = log.share_read
        height, width = state.maps.tiled(state.best).shape
        side = state.maps.resolution_m
        real = (report.stamp_ns - self._first_ns) * 1e-9 / seconds
        left = f"{seconds * (1 - share) / share:.0f} s left" if share else ""
        self._show(
            share,
            f"{self._scans} scans, {self._scans / seconds:.0f}/s, {real:.0f} x real time, "
            f"N_eff {self._n_eff:.1f} of {len(state.poses)}, "
            f"map {width * side:.0f} x {height * side:.0f} m, {state.maps.nbytes / 1e6:.0f} MB, {left}",
        )
