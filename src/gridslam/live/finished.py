"""Reads the folder of a finished run, of any command, for its replay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.trajectory import align, associate
from gridslam.geometry.se2 import compose
from gridslam.io.g2o import read_g2o
from gridslam.io.landmarks import read_landmarks
from gridslam.io.maps import read_map
from gridslam.io.text import read_json, read_text, stay_below
from gridslam.io.trajectories import read_trajectory_csv, read_tum
from gridslam.live.ancestry_tree import NO_POINTS, Float32Array
from gridslam.live.history import History
from gridslam.live.history_file import HISTORY_NAME, read_history
from gridslam.live.results import MappedRun, Results, StaticView, TrajectoryRun
from gridslam.live.scene import MOST_MESSAGES
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

_BELIEF_HEADER = "stamp_s,lost,lost_probability,inlier_ratio,particles,n_eff,injection_ratio"
_MOST = 1e12  # of particles
_WRITERS = "gridslam map, localize, grid, landmarks, graph or merge"


def read_results(out: Path) -> tuple[Results, str, list[dict[str, Any]]]:
    """Return the results in the folder of a command, their name, and the messages of the run.

    Raises
    ------
    InputError
        A file is missing or malformed, the files are not of one run, or another command wrote the folder.
    """
    name = "graph.json" if (out / "graph.json").is_file() and not (out / "run.json").is_file() else "run.json"
    document = _read_document(out / name)
    kind = str(document.get("schema", "")).rpartition("/")[0]
    if kind not in _READERS:
        raise InputError(out / name, f"expected what {_WRITERS} wrote, got schema {kind or 'none'}")
    source = document.get("input")
    title = Path(str(source.get("path") if isinstance(source, dict) else "") or out.resolve()).name
    return _READERS[kind](out, document), title, _read_messages(out / name, document)


def _read_mapping(out: Path, document: dict[str, Any]) -> Results:
    history = read_optional_history(out)
    if history is None:
        return _read_merge(out, document)
    poses = read_g2o(out / "graph.g2o").graph.poses
    keys = len(history.stamps_ns)
    if len(poses) < keys:
        raise InputError(out / HISTORY_NAME, f"expected at most {len(poses)} key scans, got {keys}")
    return MappedRun(history, read_tum(out / "trajectory.tum"), poses, read_map(out / "map.yaml"))


def _read_localization(out: Path, document: dict[str, Any]) -> Results:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    belief = _read_belief(out / "belief.csv")
    if len(belief) != len(trajectory):
        raise InputError(out / "belief.csv", f"expected {len(trajectory)} scans, got {len(belief)}")
    grid, missing = _read_known_map(document)
    is_global = document.get("initial_pose") == "global"
    return TrajectoryRun(trajectory, covariances, grid, belief=belief, missing=missing, is_global=is_global)


def _read_landmark_run(out: Path, document: dict[str, Any]) -> Results:
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    path = out / "landmarks.csv"
    if not path.is_file():  # a localization with known landmarks
        return TrajectoryRun(trajectory, covariances)
    found = read_landmarks(path)
    rows = np.column_stack([found.positions, found.covariances[:, [0, 0, 1], [0, 1, 1]]]).astype(np.float32)
    return TrajectoryRun(trajectory, covariances, landmarks=rows)


def _read_graph(out: Path, document: dict[str, Any]) -> Results:
    found = read_g2o(out / "graph.g2o")
    return StaticView(None, found.graph, found.is_landmark)


def _read_merge(out: Path, document: dict[str, Any]) -> Results:
    graph = read_g2o(out / "graph.g2o").graph
    return StaticView(read_map(out / "map.yaml"), graph, trajectory=read_tum(out / "trajectory.tum"))


_READERS: dict[str, Callable[[Path, dict[str, Any]], Results]] = {
    "gridslam.run": _read_mapping,
    "gridslam.localization": _read_localization,
    "gridslam.landmarks": _read_landmark_run,
    "gridslam.landmark_localization": _read_landmark_run,
    "gridslam.grid": lambda out, document: StaticView(read_map(out / "map.yaml")),
    "gridslam.graph": _read_graph,
    "gridslam.merge": _read_merge,
}


def read_truth(out: Path, trajectory: Trajectory | None) -> Float32Array:
    """Return the true path (P, 2), aligned rigidly with a run's by their stamps; empty if there is no `truth.tum`.

    Raises
    ------
    InputError
        The file is damaged, or no stamp is one of the run's.
    """
    path = out / "truth.tum"
    if trajectory is None or not path.is_file():
        return NO_POINTS
    truth = read_tum(path)
    own, matched = associate(trajectory, truth)
    if not len(own):
        raise InputError(path, "expected stamps of the run, within 20 ms, got none")
    moved = align(truth.poses[matched, :2], trajectory.poses[own, :2])
    aligned: Float32Array = compose(moved, truth.poses)[:, :2].astype(np.float32)
    return aligned


def read_optional_history(out: Path) -> History | None:
    """Return the history of a run; None if the folder has none."""
    path = out / HISTORY_NAME
    history = read_history(path) if path.is_file() else None
    return history if history is not None and history.moments else None


def count_key_scans(results: Results, history: History | None) -> IntArray:
    """Return for each step of a run how many key scans there had been, as its history counts them."""
    steps = len(results.times_s)
    if history is None or results.trajectory is None or isinstance(results, MappedRun):
        return np.arange(1, steps + 1)
    stamps_ns = np.maximum.accumulate([moment.stamp_ns for moment in history.moments])
    keys = np.array([0, *(moment.keys for moment in history.moments)])
    counted: IntArray = keys[np.searchsorted(stamps_ns, results.trajectory.stamps_ns, "right")]
    return counted


def _read_messages(path: Path, document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the messages of a run (`gridslam.messages.Messages.to_list`); none of a run that has kept none."""
    messages = document.get("messages", [])
    kinds: dict[str, Any] = {
        "level": str,
        "text": str,
        "count": int,
        "first_s": (int, float),
        "last_s": (int, float),
        "state": bool,
    }
    for message in messages if isinstance(messages, list) else [None]:
        if not isinstance(message, dict) or not all(isinstance(message.get(key), kinds[key]) for key in kinds):
            raise InputError(path, f"messages: expected objects with {', '.join(kinds)}, got {message!r:.60}")
    return [{key: message[key] for key in kinds} for message in messages[:MOST_MESSAGES]]


def _read_document(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, f"no such file; expected the folder that {_WRITERS} wrote")
    return read_json(path)


def _read_known_map(document: dict[str, Any]) -> tuple[OccupancyGrid | None, str]:
    """Return the map of a localization from its original path; None and a message if it cannot be read."""
    source = document.get("input")
    path = Path(str(source.get("map") or "")) if isinstance(source, dict) else Path()
    try:
        with stay_below(None):  # it lies elsewhere, as a rule
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
        if not all(0 <= value < _MOST for value in numbers[:4]) or numbers[4] >= _MOST:
            problem = f"expected numbers >= 0 and below {_MOST:g} ({_BELIEF_HEADER})"
            raise InputError(path, f"{problem}, got {line!r:.200}", number)
        rows.append(numbers)
    return np.array(rows).reshape(-1, 5)
