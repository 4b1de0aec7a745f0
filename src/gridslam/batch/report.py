"""OUT/report.html: the runs of a batch as one static page, which opens without a network or a server."""

from __future__ import annotations

import html
import json
import math
import re
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from gridslam.batch.runs import Run, read_runs
from gridslam.io.output import write_atomically

REPORT: Final = "report.html"
"""Name of the page in the output folder of a batch."""

COLUMNS: Final = (
    ("error_m", "error", "m"),
    ("error_rad", "error, heading", "rad"),
    ("worst_m", "worst error", "m"),
    ("sharpness_m", "sharpness of walls", "m"),
    ("latency_median_s", "scan, median", "ms"),
    ("latency_p99_s", "scan, 99 %", "ms"),
    ("cpu_s", "CPU time", "s"),
    ("wall_s", "wall time", "s"),
    ("peak_memory_bytes", "memory", "bytes"),
    ("scans", "scans", "count"),
    ("duration_s", "length", "s"),
    ("path_m", "driven", "m"),
    ("closures", "recognized closures", "count"),
    ("lost_scans", "lost scans", "count"),
)
"""Figures that the page can show: name, label and unit; a column without a value is left out."""

_PICTURES = ("map.png", "localization.png", "landmarks.png")
_TAIL_LETTERS = 600
_DIGITS = 6


def write_report(out: str | Path) -> Path:
    """Write OUT/report.html.

    Parameters
    ----------
    out : str or Path
        Output folder of `gridslam batch`, with its journal.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        There is no journal in the folder, or it is damaged.
    OutputError
        The page cannot be written.
    """
    folder = Path(out)
    runs = [_describe(folder, run) for run in read_runs(folder)]
    columns = [list(column) for column in COLUMNS if _is_shown(column[0], runs)]
    if any(run["findings"] for run in runs):
        columns.insert(0, ["findings", "findings", "text"])
    page = _fill(f"gridslam batch: {folder.resolve().name}", {"columns": columns, "runs": runs})
    path = folder / REPORT
    with write_atomically(path) as target:
        target.write_text(page, encoding="utf-8", errors="backslashreplace")
    return path


def _is_shown(name: str, runs: list[dict[str, Any]]) -> bool:
    values = [run["figures"].get(name) for run in runs]
    return any(value is not None for value in values)


def _fill(title: str, data: dict[str, Any]) -> str:
    static = files("gridslam.batch") / "static"
    # As JSON within a script element, "<" must not begin a tag.
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    parts = {
        "title": html.escape(title),
        "css": (static / "report.css").read_text(encoding="utf-8"),
        "js": (static / "report.js").read_text(encoding="utf-8"),
        "data": text,
    }
    page = (static / "report.html").read_text(encoding="utf-8")
    return re.sub(r"\{(title|css|js|data)\}", lambda name: parts[name[1]], page)


def _describe(out: Path, run: Run) -> dict[str, Any]:
    """Return the values of a run that the page shows."""
    row = run.row
    figures = run.figures | {
        name: row[name] for name in ("wall_s", "cpu_s", "peak_memory_bytes") if row[name] is not None
    }
    log = str(row["log"])
    seed = run.figures.get("seed")
    return {
        "log": log,
        "name": log.rstrip("/").rpartition("/")[2] or log,
        "note": row["command"] + (f", seed {seed:.0f}" if seed is not None else ""),
        "folder": row["folder"],
        "failed": not run.is_done,
        "error": row["error"] or ("" if run.is_done else "failed"),
        "message": row["message"] or "",
        "tail": "" if run.is_done else (row["output_tail"] or "")[-_TAIL_LETTERS:],
        "figures": {name: _round(value) for name, value in figures.items() if name in _NAMES},
        "findings": [list(finding) for finding in run.findings],
        "picture": _find_picture(out / row["folder"]) if run.is_done and row["folder"] else None,
    }


_NAMES = frozenset(name for name, _, _ in COLUMNS)


def _round(value: float) -> float:
    return value if value == 0 else round(value, _DIGITS - 1 - math.floor(math.log10(abs(value))))


def _find_picture(folder: Path) -> str | None:
    """Name of the picture of a run; None if there is none."""
    return next((name for name in _PICTURES if (folder / name).is_file()), None)
