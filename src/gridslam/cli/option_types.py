"""Types of options: each checks its value before the work begins, and that a target can be written.

Importing this module is cheap, so that help is quick.
"""

from __future__ import annotations

import errno
import math
import os
from pathlib import Path
from typing import Any, Final

import click

from gridslam.errors import OutputError

_MOST_S: Final = 9e9
"""Longest time, s: 285 years, in ns less than 64 bits hold."""


class Number(click.FloatRange):
    """A finite number in a range."""

    def __init__(self, min: float | None = None, max: float = 1e9, *, above: bool = False) -> None:
        """`above`: the least number itself is out of the range. The greatest is beyond any length, time or factor."""
        super().__init__(min, max, min_open=above)
        self._greatest = max

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401
        """Read the number."""
        number = click.FLOAT.convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"expected a finite number, got {number:g}", param, ctx)
        if self.min is None and abs(number) > self._greatest:
            self.fail(f"expected a number of at most {self._greatest:g}, got {number:g}", param, ctx)
        return super().convert(number, param, ctx)

    def _describe_range(self) -> str:
        """Describe the range for help, where there is one that concerns the user."""
        return "" if self.min is None else super()._describe_range()


class _Path(click.Path):
    """A path that a file may have.

    The empty one, as of a shell's variable that is not set, would mean the current folder.
    """

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401
        if value == "":
            self.fail("expected a path, got an empty string", param, ctx)
        if isinstance(value, str) and "://" in value:
            self.fail("expected a path on this machine, got a URL: download it first", param, ctx)
        try:
            os.stat(value)
        except (OSError, ValueError) as error:  # one that is absent is reported by who reads it
            if not isinstance(error, OSError) or error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
                problem = getattr(error, "strerror", None) or error
                self.fail(f"expected a path, got one that no file can have: {problem}", param, ctx)
        return super().convert(value, param, ctx)


class _Target(_Path):
    """A file or folder that the command writes: it must be possible to make it.

    A folder for it is made when it is written.
    """

    is_folder = False

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401
        path: Path = super().convert(value, param, ctx)
        from gridslam.io.output import require_writable

        try:
            require_writable(path, is_folder=self.is_folder)
        except OutputError as error:
            raise click.ClickException(str(error)) from None
        return path


class _TargetFolder(_Target):
    """A folder that the command writes to."""

    is_folder = True


PATH = _Path()
OUT = OUTPUT_FOLDER = _TargetFolder()
OUTPUT_FILE = _Target()
SECONDS = Number(max=_MOST_S)
TIME_LIMIT = Number(0, _MOST_S, above=True)
SEED = click.IntRange(min=0)
THREADS = click.IntRange(1, 256)
