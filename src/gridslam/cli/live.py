"""What commands share that show a run in the browser; without --live nothing of the web server is imported."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gridslam.errors import ArgumentError, OutputError
from gridslam.live.options import LiveOptions

if TYPE_CHECKING:
    from gridslam.api import MapResult
    from gridslam.io.measurement import Measurement
    from gridslam.live.page import LivePage
    from gridslam.pipeline import Stopwatch
    from gridslam.ros import NodeCore
    from gridslam.ros.node.messages import Diagnostics
    from gridslam.types import OccupancyGrid
    from gridslam.viz.rerun_recording import RerunRecording

__all__ = [
    "host_options", "live_options", "live_page", "node_page", "observe_source", "serve_page", "show_result",
    "wait_for_viewer",
]  # fmt: skip

_Command = TypeVar("_Command", bound=Callable[..., Any])
_Page = TypeVar("_Page")

_VIEWER_TIMEOUT_S = 60.0
_HOST_OPTIONS = (
    click.option("--live-port", type=int, metavar="PORT", help="Port of the page; 0: any free one.  [default: 8642]"),
    click.option(
        "--live-host",
        metavar="HOST",
        help="Address of the page; any other than 127.0.0.1 exposes it, protected by a token.",
    ),
)


def live_options(command: _Command) -> _Command:
    """Add --live, --live-port and --live-host to a command, which gets them as ``live``: LiveOptions, or None."""

    @functools.wraps(command)
    def wrapper(live: bool, live_port: int | None, live_host: str | None, **given: Any) -> Any:  # noqa: ANN401
        if not live and (live_port is not None or live_host is not None):
            raise click.UsageError("--live-port and --live-host need --live")
        return command(live=_options(live_port, live_host) if live else None, **given)

    for option in (
        *_HOST_OPTIONS[::-1],
        click.option("--live", is_flag=True, help="Show the run live in the browser."),
    ):
        wrapper = option(wrapper)
    return wrapper  # type: ignore[return-value]


def host_options(command: _Command) -> _Command:
    """Add --live-port and --live-host to a command that serves a page anyway, and gets them as ``live``."""

    @functools.wraps(command)
    def wrapper(live_port: int | None, live_host: str | None, **given: Any) -> Any:  # noqa: ANN401
        return command(live=_options(live_port, live_host), **given)

    for option in _HOST_OPTIONS[::-1]:
        wrapper = option(wrapper)
    return wrapper  # type: ignore[return-value]


@contextmanager
def serve_page(page: AbstractContextManager[_Page]) -> Iterator[_Page]:
    """Enter a page; a port that is taken is bad usage."""
    with ExitStack() as stack:
        try:
            entered = stack.enter_context(page)
        except OutputError as error:
            raise click.ClickException(str(error)) from None
        yield entered


@contextmanager
def live_page(
    live: LiveOptions | None, title: str, range_max_m: float, known: OccupancyGrid | None = None
) -> Iterator[LivePage | None]:
    """Give the page of a run, or None where none is wanted; in the end it stays as long as someone looks."""
    if live is None:
        yield None
        return
    from gridslam.live.page import LivePage

    with serve_page(LivePage(title, live, range_max_m=range_max_m, known=known)) as page:
        click.echo(f"gridslam: live at {page.url}", err=True)
        yield page
        if page.viewers:
            click.echo("gridslam: the page stays open while it is looked at; Ctrl-C ends it", err=True)
            try:
                page.serve_until_left()
            except KeyboardInterrupt:  # the results are written, and nothing is cut short
                return


@contextmanager
def node_page(live: LiveOptions, title: str, core: NodeCore, known: OccupancyGrid | None) -> Iterator[None]:
    """Serve the page of a node that is not started yet, until it has ended."""
    from gridslam.live.control import RobotControl
    from gridslam.live.page import LivePage

    robot = RobotControl(lambda: core.is_paused, core.pause)
    page = LivePage(title, live, range_max_m=core.configuration.range_max_m, known=known, robot=robot)
    with serve_page(page):

        def on_diagnostics(diagnostics: Diagnostics) -> None:
            page.show_message(diagnostics.summary if diagnostics.level else "")

        core.add_observer(page.observer, page.follow_session, on_diagnostics)
        click.echo(f"gridslam: live at {page.url}", err=True)
        yield


def observe_source(
    source: Iterable[Measurement], page: LivePage | None, recording: RerunRecording | None, watch: Stopwatch
) -> Iterator[Measurement]:
    """The measurements of a log, each when the page's viewers want it, and recorded."""
    paced = iter(source) if page is None else page.pace(source, watch)
    return paced if recording is None else recording.followed(paced)


def wait_for_viewer(page: LivePage | None) -> None:
    """Give someone a minute to open the page; if nobody comes, go as fast as can be."""
    if page is not None:
        click.echo(
            f"gridslam: open the page to begin; without it the run begins in {_VIEWER_TIMEOUT_S:.0f} s", err=True
        )
        if not page.wait_for_viewer(_VIEWER_TIMEOUT_S):
            page.control.set_speed(None)


def show_result(viewer: LivePage | RerunRecording | None, result: MapResult) -> None:
    """Show what a run came to in the end, on its page or in its recording."""
    if viewer is None:
        return
    import numpy as np  # help must not pay for it

    poses = result.graph.poses
    closures = np.zeros((0, 2), np.int64) if result.loop_summary is None else result.loop_summary.closures
    viewer.finish(result.map, poses, poses[closures, :2].reshape(-1, 4))


def _options(port: int | None, host: str | None) -> LiveOptions:
    given = {name: value for name, value in (("port", port), ("host", host)) if value is not None}
    try:
        return LiveOptions(**given)  # type: ignore[arg-type]
    except ArgumentError as error:
        raise click.ClickException(f"--live-{error}") from None
