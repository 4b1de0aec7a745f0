"""What options of several commands share."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["PATH", "SEED", "SETTINGS", "json_option"]

PATH = click.Path(path_type=Path)
SEED = click.IntRange(min=0)
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text, and no progress."
)
