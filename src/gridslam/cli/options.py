"""What options of several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, final

import click

__all__ = ["PATH", "SEED", "SETTINGS", "Pose", "json_option"]


@final
class _Path(click.Path):
    """A path; the empty one, as of a shell's variable that is not set, would mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401
        if value == "":
            self.fail("expected a path, got an empty string", param, ctx)
        return super().convert(value, param, ctx)


@final
class Pose(click.ParamType):
    """A pose (x, y, theta); None for the word that means that it is not known, where there is one."""

    name = "X,Y,THETA"

    def __init__(self, unknown: str = "") -> None:
        self.unknown = unknown

    def convert(
        self,
        value: Any,
        param: click.Parameter | None,
        ctx: click.Context | None,  # noqa: ANN401
    ) -> tuple[float, float, float] | None:
        """Three numbers with commas between them, m and rad."""
        if self.unknown and value == self.unknown:
            return None
        try:
            x, y, theta = (float(number) for number in value.split(","))
        except ValueError:
            x = y = theta = math.nan
        if not math.isfinite(x + y + theta):
            other = f" or {self.unknown}" if self.unknown else ""
            self.fail(f"expected X,Y,THETA (m, rad){other}, got {value!r}", param, ctx)
        return x, y, theta


PATH = _Path(path_type=Path)
SEED = click.IntRange(min=0)
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text, and no progress."
)
