"""Reader of a command's output folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gridslam.errors import InputError
from gridslam.io.g2o import read_g2o
from gridslam.io.landmarks import read_landmarks
from gridslam.io.maps import read_map
from gridslam.io.results.record import read_record
from gridslam.io.text import read_text
from gridslam.io.trajectories import read_trajectory_csv, read_tum
from gridslam.live.results import MappedRun, Results, StaticMap, TrajectoryRun
from gridslam.live.run import make_run_info
from gridslam.types import FloatArray, IntArray, OccupancyGrid

__all__ = ["FinishedRun", "open_finished_run"]

_BELIEF_HEADER = "stamp_s,lost,lost_probability,inlier_ratio,particles,n_eff,injection_ratio"


class FinishedRun(NamedTuple):
    """A finished run.

    Attributes
    ----------
    results : Results
    run_info : dict
        First message to a viewer (see `gridslam.live.run.make_run_info`).
    missing : str
        A message about missing files; empty if nothing is missing.
    """

    results: Results
    run_info: dict[str, Any]
    missing: str = ""


def open_finished_run(folder: str | Path) -> FinishedRun:
    """Read OUT of `gridslam map`, `localize`, `grid` or `landmarks`.

    Raises
    ------
    InputError
        A file is missing or malformed, the files are not of one run, or another command wrote the folder.
    """
    out = Path(folder)
    document = _read_document(out / "run.json")
    kind = str(document.get("schema", "")).rpartition("/")[0]
    if kind not in _READERS:
        raise InputError(out / "run.json", f"expected what {_WRITERS} wrote, got schema {kind or 'none'}")
    source = document.get("input")
    title = Path(str(source.get("path") if isinstance(source, dict) else "") or out.resolve()).name
    return _READERS[kind](out, document, title)


_WRITERS = "gridslam map, localize, grid or landmarks"


def _read_mapping(out: Path, document: dict[str, Any], title: str) -> FinishedRun:
    record, poses = read_record(out / "record.npz"), read_g2o(out / "graph.g2o").graph.poses
    trajectory, grid = read_tum(out / "trajectory.tum"), read_map(out / "map.yaml")
    if not len(record) or len(poses) != len(record):
        raise InputError(out / "record.npz", f"expected {len(poses)} key scans, got {len(record)}")
    run = MappedRun(record, trajectory, poses, grid, _read_closures(document, len(record)))
    layers = "map", "path", "ancestry", "particles", "weights", "closures", "n_eff", "latency"
    return FinishedRun(run, make_run_info(title, "replay", layers, grid=grid))


def _read_localization(out: Path, document: dict[str, Any], title: str) -> FinishedRun:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    belief = _read_belief(out / "belief.csv")
    if len(belief) != len(trajectory):
        raise InputError(out / "belief.csv", f"expected {len(trajectory)} scans, got {len(belief)}")
    grid, missing = _read_known_map(document)
    layers = *(("map",) if grid else ()), "path", "n_eff", "lost_probability"
    return FinishedRun(
        TrajectoryRun(trajectory, covariances, grid, belief=belief),
        make_run_info(title, "replay", layers, "scan", grid),
        missing,
    )


def _read_landmark_run(out: Path, document: dict[str, Any], title: str) -> FinishedRun:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    path = out / "landmarks.csv"
    if not path.is_file():  # a localization with known landmarks
        return FinishedRun(TrajectoryRun(trajectory, covariances), make_run_info(title, "replay", ("path",), "step"))
    found = read_landmarks(path)
    rows = np.column_stack([found.positions, found.covariances[:, [0, 0, 1], [0, 1, 1]]]).astype(np.float32)
    run_info = make_run_info(title, "replay", ("path", "landmarks"), "step")
    return FinishedRun(TrajectoryRun(trajectory, covariances, landmarks=rows), run_info)


def _read_grid(out: Path, document: dict[str, Any], title: str) -> FinishedRun:
    grid = read_map(out / "map.yaml")
    return FinishedRun(StaticMap(grid), make_run_info(title, "still", ("map",), grid=grid))


_READERS = {
    "gridslam.run": _read_mapping,
    "gridslam.localization": _read_localization,
    "gridslam.landmarks": _read_landmark_run,
    "gridslam.landmark_localization": _read_landmark_run,
    "gridslam.grid": _read_grid,
}


def _read_document(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, f"no such file; expected the folder that {_WRITERS} wrote")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, f"expected JSON, got: {error}") from None
    if not isinstance(document, dict):
        raise InputError(path, "expected a JSON object")
    return document


def _read_closures(document: dict[str, Any], keys: int) -> IntArray:
    """Return the key scans (C, 2) of the loop closures, the older one first, without those not in the record."""
    source = document.get("loop_closure") or {}
    pairs = np.array([closure["key_scans"] for closure in source.get("closures", [])], np.int64).reshape(-1, 2)
    return pairs[(pairs >= 0).all(axis=1) & (pairs < keys).all(axis=1)]


def _read_known_map(document: dict[str, Any]) -> tuple[OccupancyGrid | None, str]:
    """Return the map of a localization from its original path; None and a message if it cannot be read."""
    source = document.get("input")
    path = Path(str(source.get("map") or "")) if isinstance(source, dict) else Path()
    try:
        return read_map(path), ""
    except InputError as error:
        return None, f"without the map: {error}"


def _read_belief(path: Path) -> FloatArray:
    """Read belief.csv as (T, 5): lost, lost probability, inlier ratio, particles, effective sample size (or NaN)."""
    header, *lines = read_text(path).splitlines() or [""]
    if header != _BELIEF_HEADER:
        raise InputError(path, f"expected the columns {_BELIEF_HEADER}, got {header!r:.200}", 1)
    rows = []
    for number, line in enumerate(lines, 2):
        try:
            _, *numbers, _ = (float(word or "nan") for word in line.split(","))
        except ValueError:
            raise InputError(path, f"expected numbers ({_BELIEF_HEADER}), got {line!r:.200}", number) from None
        if len(numbers) != 5:
            raise InputError(path, f"expected seven numbers ({_BELIEF_HEADER}), got {line!r:.200}", number)
        rows.append(numbers)
    return np.array(rows).reshape(-1, 5)
