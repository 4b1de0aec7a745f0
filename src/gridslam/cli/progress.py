"""How far a run has come: a bar on a terminal, a line every few seconds elsewhere; both on stderr."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import final

from gridslam.io.log_statistics import LogStatistics
from gridslam.slam.state import GridFastSlamState
from gridslam.types import StepReport

__all__ = ["Progress", "progress", "reading_progress"]

_BAR_EVERY_S, _LINE_EVERY_S = 0.25, 5.0


@contextmanager
def progress(statistics: Callable[[], LogStatistics], *, shown: bool = True) -> Iterator[Progress]:
    """Give what shows how far the mapping of a log has come; nothing is printed where nothing is to be shown."""
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
    """Give what shows a share and a text, and every how many seconds it is to be called."""
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
    """Observer that tells rate, effective sample size, size of the map and time left, now and then.

    After the last scan `show_refinement` tells that the work goes on.
    """

    def __init__(
        self, statistics: Callable[[], LogStatistics], show: Callable[[float, str], None], every_s: float
    ) -> None:
        """Show a share of 1 and a text by `show`, every so many seconds."""
        self._statistics, self._show, self._every_s = statistics, show, every_s
        self._began, self._ended = time.perf_counter(), math.inf
        self._due = self._began + every_s
        self._scans, self._n_eff, self._first_ns = 0, 0.0, 0

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Take note of one scan."""
        self._first_ns = self._first_ns if self._scans else report.stamp_ns
        self._scans += 1
        if report.skipped is None:
            self._n_eff = report.n_eff
        if (now := time.perf_counter()) >= self._due:
            self._due = now + self._every_s
            self._show_rate(now - self._began, report, state)

    def show_refinement(self) -> None:
        """Tell for how long the last word has been looked for, now and then."""
        now = time.perf_counter()
        self._ended = min(self._ended, now)
        if now >= self._due:
            self._due = now + self._every_s
            self._show(1.0, f"{self._scans} scans; the last word, for {now - self._ended:.0f} s")

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
