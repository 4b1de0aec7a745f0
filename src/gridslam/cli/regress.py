"""gridslam regress."""

from __future__ import annotations

from pathlib import Path

from gridslam.batch.regress import compare_batches
from gridslam.cli.output import print_result

EXIT_WORSE = 1
"""Exit status if something is worse beyond noise."""


def regress(old: Path, new: Path, level: float, error_margin: float, cost_margin: float, as_json: bool) -> int:
    """Compare two runs of the same logs, print the changes, and return the exit status."""
    found = compare_batches(old, new, level=level, error_margin=error_margin / 100.0, cost_margin=cost_margin / 100.0)
    print_result(found.document(), found.lines(), as_json)
    return EXIT_WORSE if found.worse else 0
