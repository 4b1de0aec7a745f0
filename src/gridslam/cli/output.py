"""What commands share: the folder OUT, and one JSON object on stdout."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from gridslam.errors import OutputError
from gridslam.io.output import OutputFolder

__all__ = ["open_output", "print_json"]


@contextmanager
def open_output(path: Path) -> Iterator[OutputFolder]:
    """Open OUT before the long work; one that cannot be written is bad usage."""
    with ExitStack() as stack:
        try:
            out = stack.enter_context(OutputFolder(path))
        except OutputError as error:
            raise click.ClickException(str(error)) from None
        yield out


def print_json(document: Mapping[str, Any]) -> None:
    """Print the one object that --json promises."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))
