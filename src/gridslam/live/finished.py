"""Reads what a command wrote into OUT."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gridslam.errors import InputError
from gridslam.io.g2o import read_g2o
from gridslam.io.landmark_files import read_landmarks
from gridslam.io.map_server import read_map
from gridslam.io.record import read_record
from gridslam.io.text_source import read_text
from gridslam.io.trajectory import read_trajectory_csv, read_tum
from gridslam.live.results import FoundWay, MappedRun, Results, StillMap
from gridslam.live.run import greeting
from gridslam.types import FloatArray, IntArray, OccupancyGrid

__all__ = ["Finished", "open_finished"]

_BELIEF = "stamp_s,lost,lost_probability,inlier_ratio,particles,n_eff,injection_ratio"


class Finished(NamedTuple):
    """A finished run.

    Attributes
    ----------
    results : Results
    hello : dict
        First message to a viewer (see `gridslam.live.run.greeting`).
    lacks : str
        What is no more there, in words; empty where nothing is missing.
    """

    results: Results
    hello: dict[str, Any]
    lacks: str = ""


def open_finished(folder: str | Path) -> Finished:
    """Read OUT of `gridslam map`, `localize`, `grid` or `landmarks`.

    Raises
    ------
    InputError
        A file is missing or malformed, they are not of one run, or the folder is none of these commands'.
    """
    out = Path(folder)
    document = _document(out / "run.json")
    kind = str(document.get("schema", "")).rpartition("/")[0]
    if kind not in _READERS:
        raise InputError(out / "run.json", f"expected what {_WRITERS} wrote, got schema {kind or 'none'}")
    told = document.get("input")
    title = Path(str(told.get("path") if isinstance(told, dict) else "") or out.resolve()).name
    return _READERS[kind](out, document, title)


_WRITERS = "gridslam map, localize, grid or landmarks"


def _mapped(out: Path, document: dict[str, Any], title: str) -> Finished:
    record, poses = read_record(out / "record.npz"), read_g2o(out / "graph.g2o").graph.poses
    trajectory, grid = read_tum(out / "trajectory.tum"), read_map(out / "map.yaml")
    if not len(record) or len(poses) != len(record):
        raise InputError(out / "record.npz", f"expected {len(poses)} key scans, got {len(record)}")
    run = MappedRun(record, trajectory, poses, grid, _closures(document, len(record)))
    shows = "map", "path", "pasts", "particles", "weights", "closures", "n_eff", "latency"
    return Finished(run, greeting(title, "replay", shows, grid=grid))


def _localized(out: Path, document: dict[str, Any], title: str) -> Finished:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    belief = _belief(out / "belief.csv")
    if len(belief) != len(trajectory):
        raise InputError(out / "belief.csv", f"expected {len(trajectory)} scans, got {len(belief)}")
    grid, lacks = _map_of(document)
    shows = *(("map",) if grid else ()), "path", "n_eff", "doubt"
    return Finished(
        FoundWay(trajectory, covariances, grid, belief=belief), greeting(title, "replay", shows, "scan", grid), lacks
    )


def _of_landmarks(out: Path, document: dict[str, Any], title: str) -> Finished:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    path = out / "landmarks.csv"
    if not path.is_file():  # of a localization among known landmarks
        return Finished(FoundWay(trajectory, covariances), greeting(title, "replay", ("path",), "step"))
    found = read_landmarks(path)
    rows = np.column_stack([found.positions, found.covariances[:, [0, 0, 1], [0, 1, 1]]]).astype(np.float32)
    hello = greeting(title, "replay", ("path", "landmarks"), "step")
    return Finished(FoundWay(trajectory, covariances, landmarks=rows), hello)


def _gridded(out: Path, document: dict[str, Any], title: str) -> Finished:
    grid = read_map(out / "map.yaml")
    return Finished(StillMap(grid), greeting(title, "still", ("map",), grid=grid))


_READERS = {
    "gridslam.run": _mapped,
    "gridslam.localization": _localized,
    "gridslam.landmarks": _of_landmarks,
    "gridslam.landmark_localization": _of_landmarks,
    "gridslam.grid": _gridded,
}


def _document(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, f"no such file; expected the folder that {_WRITERS} wrote")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, f"expected JSON, got: {error}") from None
    if not isinstance(document, dict):
        raise InputError(path, "expected a JSON object")
    return document


def _closures(document: dict[str, Any], keys: int) -> IntArray:
    """Key scans (C, 2) of the loop closures, the older one first; those that the record does not have are left out."""
    told = document.get("loop_closure") or {}
    pairs = np.array([closure["key_scans"] for closure in told.get("closures", [])], np.int64).reshape(-1, 2)
    return pairs[(pairs >= 0).all(axis=1) & (pairs < keys).all(axis=1)]


def _map_of(document: dict[str, Any]) -> tuple[OccupancyGrid | None, str]:
    """The map in which a robot was localized, from where it lay then; None, and why, where it is there no more."""
    told = document.get("input")
    path = Path(str(told.get("map") or "")) if isinstance(told, dict) else Path()
    try:
        return read_map(path), ""
    except InputError as error:
        return None, f"without the map: {error}"


def _belief(path: Path) -> FloatArray:
    """Rows of belief.csv as (T, 5): lost flag, lost probability, agreement, particles, N_eff (NaN if empty)."""
    header, *lines = read_text(path).splitlines() or [""]
    if header != _BELIEF:
        raise InputError(path, f"expected the columns {_BELIEF}, got {header!r:.200}", 1)
    rows = []
    for number, line in enumerate(lines, 2):
        try:
            _, *numbers, _ = (float(word or "nan") for word in line.split(","))
        except ValueError:
            raise InputError(path, f"expected numbers ({_BELIEF}), got {line!r:.200}", number) from None
        if len(numbers) != 5:
            raise InputError(path, f"expected seven numbers ({_BELIEF}), got {line!r:.200}", number)
        rows.append(numbers)
    return np.array(rows).reshape(-1, 5)
