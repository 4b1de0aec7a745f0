"""Viewers of a run: a page in the browser and a recorded history; each is imported on request."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from gridslam.cli.output import warn
from gridslam.live.options import LiveOptions
from gridslam.messages import Level, Messages
from gridslam.pipeline import describe_error, isolate

if TYPE_CHECKING:
    from gridslam.api.mapping import MapResult
    from gridslam.io.log import Log
    from gridslam.io.output import OutputFolder
    from gridslam.live.page import LivePage
    from gridslam.live.recorder import RunRecorder
    from gridslam.pipeline import Stopwatch
    from gridslam.ros import NodeCore
    from gridslam.ros.node.messages import Diagnostics
    from gridslam.types import OccupancyGrid


class Viewers(NamedTuple):
    """Page and history of a run, None where not wanted, and its messages."""

    page: LivePage | None
    history: RunRecorder | None
    messages: Messages

    def watch(self, source: Log, watch: Stopwatch) -> dict[str, Any]:
        """Return the arguments `observers` and `gate` of a run on a log: the page controls when scans are processed."""
        page, history = self.page, self.history
        if page is not None:
            page.observer.progress = lambda: source.statistics.share_read
            observers = [isolate(page.observer, partial(self.messages, "the page failed"))]
            return {"observers": observers, "gate": partial(page.pace, stopwatch=watch)}
        if history is not None:
            observers = [isolate(history, partial(self.messages, "the history failed"))]
            return {"observers": observers, "gate": history.follow}
        return {"observers": [], "gate": iter}

    def write_history(self, folder: OutputFolder) -> None:
        """Write the history of the run, if there is one."""
        if self.history is not None:
            from gridslam.live.history_file import HISTORY_NAME, write_history

            write_history(folder.file(HISTORY_NAME), self.history.history)

    def wait(self, timeout_s: float) -> None:
        """Wait this long for a viewer of the page; without one run at full speed."""
        if self.page is not None:
            warn(f"open the page to begin; without it the run begins in {timeout_s:.0f} s")
            if not self.page.wait_for_viewer(timeout_s):
                self.page.observer.speed = None

    def report(self, text: str, level: Level = Level.WARN) -> None:
        """Report on stderr, on the page and in run.json."""
        self.messages.report(level, text)
        if self.page is not None:
            self.page.show_messages(self.messages.to_list())

    def show_result(self, result: MapResult) -> None:
        """Show the result of a run on the page."""
        loops = result.loop_summary
        ends = np.zeros((0, 4)) if loops is None else result.closure_ends(loops.shown)
        if self.page is not None:
            try:
                self.page.finish(result.map, result.graph.poses, ends)
            except Exception as error:  # the results are more than who looks at them
                warn(f"the final map cannot be shown: {describe_error(error)}")


@contextmanager
def open_viewers(
    live: LiveOptions | None,
    title: str,
    range_max_m: float,
    known: OccupancyGrid | None = None,
    *,
    out: Path | None = None,
    has_history: bool = True,
) -> Iterator[Viewers]:
    """Yield the viewers; the page stays open while it is viewed, and replays the results in `out`.

    The known map is needed where a localization is looked at.
    """
    messages = Messages(lambda level, text: warn(text))
    if live is None:
        from gridslam.live.recorder import RunRecorder

        yield Viewers(None, RunRecorder(range_max_m) if has_history else None, messages)
        return
    from gridslam.live.page import LivePage

    with LivePage(title, live, range_max_m=range_max_m, known=known, keeps_moments=has_history) as page:
        viewers = Viewers(page, page.observer.recorder if has_history else None, messages)
        announce(page.url, live)
        yield viewers
        if page.viewers:
            warn("the page stays open while it is looked at; Ctrl-C ends it")
            try:
                page.serve_until_left(out)
            except KeyboardInterrupt:  # the results are written, and nothing is cut short
                return


@contextmanager
def node_page(live: LiveOptions, title: str, core: NodeCore) -> Iterator[None]:
    """Serve the page of a node that is not started yet, until it has ended."""
    from gridslam.live.page import LivePage
    from gridslam.ros.node.session import Localization

    known = core.configuration.known.grid if isinstance(core.configuration, Localization) else None
    page = LivePage(title, live, range_max_m=core.configuration.range_max_m, known=known)
    with page:

        def on_diagnostics(diagnostics: Diagnostics) -> None:
            page.show_state(diagnostics.state, diagnostics.values["state"])
            page.show_messages(core.messages.to_list())

        core.add_observer(page.observer, page.follow, on_diagnostics)
        announce(page.url, live)
        yield


def announce(url: str, live: LiveOptions) -> None:
    """Print the page's address to standard error, and open it if that is wanted."""
    warn(f"live at {url}")
    open_page(url, live)


def open_page(url: str, live: LiveOptions) -> None:
    """Open the page in the default browser, if that is wanted."""
    if live.opens:
        import webbrowser

        if not webbrowser.open(url):
            warn("no browser was found to open the page")


def view(out: Path, live: LiveOptions) -> None:
    """Show a finished run in the browser until interrupted, which is how it ends well."""
    from gridslam.live.replay import Replay
    from gridslam.live.server import PageServer

    replay = Replay(out, live.speed or 10.0)
    with PageServer(replay, live) as page:
        for message in replay.found.messages[: replay.found.grid is None]:
            warn(f"{out}: {message['text']}")
        click.echo(f"{out}: open {page.url} (Ctrl-C ends)")
        open_page(page.url, live)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            click.echo("closed")
