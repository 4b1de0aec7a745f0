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
    from gridslam.live.replay import ReplayPage

    with serve_page(ReplayPage(out, live)) as page:
        if page.missing:
            click.echo(f"gridslam: {out}: {page.missing}", err=True)
        click.echo(f"{out}: open {page.url} (Ctrl-C ends)")
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            click.echo("closed")
