"""Journals of batches that never ran: rows, folders and documents as `gridslam batch` leaves them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.batch.journal import COLUMNS, Journal

FAILURES = (
    ("InputError", "log.clf, line 12: expected 180 ranges, got 3", 2),
    ("timeout", "stopped after 600 s", -15),
    ("out of memory", "more than 2000 MB", -9),
    ("SIGSEGV", "ended by signal 11", -11),
)


def write_journal(out: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Write OUT/runs.sqlite with these rows; what a row lacks is null."""
    with Journal(out) as journal:
        for row in rows:
            document = row.get("document")
            journal.write(dict.fromkeys(COLUMNS) | row | {"document": json.loads(document) if document else None})


def make_document(rng: np.random.Generator, seed: int = 0, error_m: float | None = None) -> dict[str, Any]:
    """What a row needs of a `run.json`, with the scores of relations if an error is given."""
    scans = int(rng.integers(200, 20_000))
    document: dict[str, Any] = {
        "schema": "gridslam.run/3",
        "seed": seed,
        "input": {
            "duration_s": scans / 5.0,
            "odometry_length_m": scans / 20.0,
            "bytes": 150 * scans,
            "faults": {"odometry_scale": "Odometry reports 4 % less distance."} if rng.random() < 0.1 else {},
        },
        "scans": {"read": scans, "used": scans // 4, "lost": 0},
        "filter": {"particles": 30, "map_width_m": 30.0, "map_height_m": 40.0},
        "loop_closure": {"closures": [0] * int(rng.integers(0, 9))},
        "latency": {"all_scans": {"median_s": 6e-4, "p99_s": float(rng.uniform(5e-3, 2e-2)), "max_s": 0.03}},
    }
    if error_m is not None:
        relations = {"trans_mean_m": error_m, "rot_mean_deg": 10 * error_m, "trans_max_m": 8 * error_m}
        document["evaluation"] = {"relations": relations}
    return document


def make_rows(count: int, failed: int = 0, seed: int = 0) -> list[dict[str, Any]]:
    """Make rows of a batch of map, of which some failed, evenly among the others."""
    rng = np.random.default_rng(seed)
    broken = {i * count // failed: FAILURES[i % len(FAILURES)] for i in range(failed)}
    rows = []
    for i in range(count):
        log = f"s3://fleet/robot-{i % 40:02}/2026-11-{1 + i % 28:02}/run-{i:05}.bag"
        row: dict[str, Any] = {
            "key": hashlib.sha256(log.encode()).hexdigest(),
            "log": log,
            "command": "map",
            "folder": f"run-{i:05}",
            "wall_s": float(rng.uniform(1, 60)),
            "cpu_s": float(rng.uniform(1, 60)),
            "peak_memory_bytes": int(rng.uniform(1e8, 4e8)),
            "started": f"2026-11-23T{i // 3600:02}:{i // 60 % 60:02}:{i % 60:02}.000+00:00",
        }
        if i in broken:
            error, message, status = broken[i]
            tail = "gridslam: the log <b>is</b> broken </script>\n" * 3
            row |= {"status": "failed", "error": error, "message": message, "exit_status": status, "output_tail": tail}
        else:
            document = make_document(rng, error_m=float(rng.uniform(0.01, 0.2)))
            row |= {"status": "done", "exit_status": 0, "document": json.dumps(document)}
        rows.append(row)
    return rows
