"""gridslam view."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from gridslam.cli.live import serve_page
from gridslam.live.options import LiveOptions

__all__ = ["view"]


def view(out: Path, live: LiveOptions) -> None:
    """Show a finished run in the browser until interrupted, which is how it ends well."""
    from gridslam.live.replay import Replay
    from gridslam.live.server import PageServer

    replay = Replay(out)
    with serve_page(PageServer(replay, live)) as page:
        if replay.results.missing:
            click.echo(f"gridslam: {out}: {replay.results.missing}", err=True)
        click.echo(f"{out}: open {page.url} (Ctrl-C ends)")
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            click.echo("closed")
