"""The journal of a batch as rows of figures, for the page, for tables and for comparisons."""

from __future__ import annotations

import math
import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from gridslam.batch.journal import COLUMNS, JOURNAL
from gridslam.errors import InputError
from gridslam.io.database import AS_IT_LIES, open_database
from gridslam.io.text import parse_json, refuse_unreadable

DONE: Final = "done"
"""Status of a run that ended well; that of any other run is "failed"."""

_FIGURES: Final[dict[str, tuple[str, ...]]] = {
    "seed": ("seed",),
    "particles": ("filter", "particles"),
    "scans": ("scans", "read"),
    "key_scans": ("scans", "used"),
    "lost_scans": ("scans", "lost"),
    "duration_s": ("input", "duration_s"),
    "path_m": ("input", "odometry_length_m"),
    "latency_median_s": ("latency", "all_scans", "median_s"),
    "latency_p99_s": ("latency", "all_scans", "p99_s"),
    "latency_max_s": ("latency", "all_scans", "max_s"),
    "sharpness_m": ("loop_closure", "sharpness_m"),
    "map_width_m": ("filter", "map_width_m"),
    "map_height_m": ("filter", "map_height_m"),
    "bytes": ("input", "bytes"),
}
"""Figures of `run.json`, by the path of their keys."""

_DIAGNOSED: Final[dict[str, tuple[str, ...]]] = {
    "scans": ("log", "scans"),
    "duration_s": ("log", "duration_s"),
    "path_m": ("log", "odometry_length_m"),
}
"""The same of the doctor's report."""

_ERRORS: Final = {
    "relations": {"error_m": "trans_mean_m", "error_rad": "rot_mean_deg", "worst_m": "trans_max_m"},
    "ate": {"error_m": "trans_rmse_m", "error_rad": "rot_rmse_deg", "worst_m": "trans_max_m"},
}
"""Figures of the scores of `gridslam evaluate`: of relations the means, of a true trajectory the root mean squares."""


@final
@dataclass(frozen=True)
class Run:
    """One row of the journal.

    Attributes
    ----------
    row : dict
        The columns of the table but `document`.
    figures : dict of str to float
        Numbers of the document, finite, by a name with its unit (m, rad, s, bytes).
    findings : tuple of (str, str, str)
        Of the doctor: severity, code and sentence each.
    document : dict
        What the command wrote as its document; empty where there is none.
    """

    row: dict[str, Any]
    figures: dict[str, float]
    findings: tuple[tuple[str, str, str], ...]
    document: dict[str, Any]

    @property
    def is_done(self) -> bool:
        """Whether the run ended well."""
        return bool(self.row["status"] == DONE)


def read_runs(out: str | Path) -> Iterator[Run]:
    """Yield the runs of a batch in the order of their first start.

    Parameters
    ----------
    out : str or Path
        Output folder of `gridslam batch`.

    Raises
    ------
    InputError
        There is no journal in the folder, it is damaged, or it lacks a column.
    """
    path = Path(out) / JOURNAL
    if not path.is_file():
        raise InputError(path, "no such file: expected the journal of gridslam batch")
    try:
        with closing(open_database(path.resolve(), ["runs"], _choose_mode(path))) as journal:
            cursor = journal.execute(f"SELECT {', '.join(COLUMNS)} FROM runs ORDER BY started, log, key")
            for values in cursor:
                yield _make_run(path, dict(zip(COLUMNS, values, strict=True)))
    except sqlite3.Error as error:
        raise InputError(path, f"expected a journal of gridslam batch, got: {error}") from None


def _choose_mode(path: Path) -> str:
    """Open for writing where that is allowed: else SQLite leaves its -wal and -shm files beside the journal."""
    if os.access(path, os.W_OK) and os.access(path.parent, os.W_OK):
        return "mode=rw"
    return "mode=ro" if path.with_name(f"{path.name}-wal").exists() else AS_IT_LIES


def _make_run(path: Path, row: dict[str, Any]) -> Run:
    text = row.pop("document")
    with refuse_unreadable(path, f"a document in JSON of {row['log']}"):
        document = parse_json(text, odd_names=True) if text else {}
    document = document if isinstance(document, dict) else {}
    figures = {name: _number(document, keys) for name, keys in (_FIGURES | _of_doctor(document)).items()}
    loops = document.get("loop_closure")
    if isinstance(loops, dict):
        figures["closures"] = float(len(loops.get("closures", ())))
    figures |= _errors(document)
    finite = {name: value for name, value in figures.items() if value is not None and math.isfinite(value)}
    return Run(row, finite, tuple(_findings(document)), document)


def _of_doctor(document: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    return _DIAGNOSED if "findings" in document else {}


def _errors(document: Mapping[str, Any]) -> dict[str, float | None]:
    """Return errors of a trajectory: of `gridslam evaluate` itself, or of a run that was scored (key `evaluation`)."""
    scores = document.get("evaluation", document)
    found: dict[str, float | None] = {}
    for kind, names in _ERRORS.items():
        for name, key in names.items():
            value = _number(scores, (kind, key))
            if value is not None:
                found[name] = math.radians(value) if name == "error_rad" else value
    return found


def _number(document: object, keys: tuple[str, ...]) -> float | None:
    for key in keys:
        if not isinstance(document, Mapping):
            return None
        document = document.get(key)
    return float(document) if isinstance(document, int | float) and not isinstance(document, bool) else None


def _findings(document: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Return the findings of the doctor: from its report, and of `run.json` the faults and the repairs."""
    for finding in document.get("findings") or ():
        if finding.get("severity") != "info":
            yield finding["severity"], finding["code"], finding["message"]
    given = document.get("input")
    if isinstance(given, Mapping):
        for code, sentence in (given.get("faults") or {}).items():
            yield "warning", code, sentence
