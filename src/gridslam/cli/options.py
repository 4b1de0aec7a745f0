"""What options of several commands share."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import click

from gridslam.errors import ArgumentError

__all__ = ["PATH", "SEED", "SETTINGS", "json_option", "name_option", "read_pose"]


@final
class _Path(click.Path):
    """A path; the empty one, as of a shell's variable that is not set, would mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401
        if value == "":
            self.fail("expected a path, got an empty string", param, ctx)
        return super().convert(value, param, ctx)


def read_pose(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[float, float, float] | None:
    """Read an option's pose, X,Y,THETA in m and rad; its default means that there is none."""
    if text is None or text == param.default:
        return None
    try:
        x, y, theta = (float(number) for number in text.split(","))
    except ValueError:
        x = y = theta = math.nan
    if not math.isfinite(x + y + theta):
        other = f" or {param.default}" if isinstance(param.default, str) else ""
        raise click.BadParameter(f"expected X,Y,THETA (m, rad){other}, got {text!r}", ctx, param)
    return x, y, theta


@contextmanager
def name_option(**options: str) -> Iterator[None]:
    """Report an invalid argument under the name of its option: `pose="--initial-pose"`."""
    try:
        yield
    except ArgumentError as error:
        if error.argument not in options:
            raise
        raise click.ClickException(str(error).replace(error.argument, options[error.argument], 1)) from None


PATH = _Path(path_type=Path)
SEED = click.IntRange(min=0)
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text, and no progress."
)
