"""Reads the folder of a finished run, for its replay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.trajectory import align, associate
from gridslam.geometry.se2 import compose
from gridslam.io.g2o import read_g2o
from gridslam.io.maps import read_map
from gridslam.io.text import read_json
from gridslam.io.trajectories import read_tum
from gridslam.live.history import History
from gridslam.live.history_file import HISTORY_NAME, read_history
from gridslam.live.protocol import NO_POINTS, Float32Array
from gridslam.live.scene import MOST_MESSAGES
from gridslam.messages import Level, Messages
from gridslam.types import FloatArray, OccupancyGrid, Trajectory

_KINDS = "gridslam.run", "gridslam.localization", "gridslam.grid", "gridslam.merge"
_WRITERS = "gridslam map, localize, grid or merge"


@final
@dataclass(frozen=True, slots=True, eq=False)
class FinishedRun:
    """Content of the folder of a command.

    Attributes
    ----------
    title : str
        Name of the log.
    grid : OccupancyGrid or None
        The map; None if that of a localization is not where it was.
    poses : (K, 3) float64
        The final poses of the key scans, of earlier drives first; those of a localization as they were online.
    history : History or None
        The past of the newest drive; None if it was not recorded.
    truth : (P, 2) float32, m
        The true path, aligned rigidly with the key scans by their stamps; empty if there is no `truth.tum`.
    messages : list of dict
        What the run has reported (`gridslam.messages.Messages.to_list`).
    is_localization : bool
        Whether the map was known.
    """

    title: str
    grid: OccupancyGrid | None
    poses: FloatArray
    history: History | None
    truth: Float32Array
    messages: list[dict[str, Any]]
    is_localization: bool


def read_finished_run(out: Path) -> FinishedRun:
    """Read the folder of a command.

    Raises
    ------
    InputError
        A file is missing or malformed, the files are not of one run, or another command wrote the folder.
    """
    path = out / "run.json"
    if not path.is_file():
        raise InputError(path, f"no such file; expected the folder that {_WRITERS} wrote")
    document = read_json(path)
    kind = str(document.get("schema", "")).rpartition("/")[0]
    if kind not in _KINDS:
        raise InputError(path, f"expected what {_WRITERS} wrote, got schema {kind or 'none'}")
    source = document.get("input")
    source = source if isinstance(source, dict) else {}
    title = Path(str(source.get("path") or "") or out.resolve()).name
    messages = _read_messages(path, document)
    history = _read_optional_history(out)
    is_localization = kind == "gridslam.localization"
    if is_localization:
        grid, problem = _read_known_map(Path(str(source.get("map") or "")))
        messages = problem + messages
    else:
        grid = read_map(out / "map.yaml")
    poses = _read_poses(out, history, is_localization)
    return FinishedRun(title, grid, poses, history, _read_truth(out, poses, history), messages, is_localization)


def _read_optional_history(out: Path) -> History | None:
    path = out / HISTORY_NAME
    history = read_history(path) if path.is_file() else None
    return history if history is not None and history.moments else None


def _read_poses(out: Path, history: History | None, is_localization: bool) -> FloatArray:
    """Return the poses (K, 3) of the key scans, at least those of the history."""
    keys = 0 if history is None else len(history.stamps_ns)
    poses: FloatArray = np.zeros((0, 3))
    if is_localization and history is not None:
        trajectory = read_tum(out / "trajectory.tum")
        at = np.minimum(np.searchsorted(trajectory.stamps_ns, history.stamps_ns), len(trajectory) - 1)
        poses = trajectory.poses[at]
    elif (out / "graph.g2o").is_file() or history is not None:
        poses = read_g2o(out / "graph.g2o").graph.poses
    if len(poses) < keys:
        raise InputError(out / HISTORY_NAME, f"expected at most {len(poses)} key scans, got {keys}")
    return poses


def _read_truth(out: Path, poses: FloatArray, history: History | None) -> Float32Array:
    path = out / "truth.tum"
    if history is None or not path.is_file():
        return NO_POINTS
    truth = read_tum(path)
    stamps_ns = np.array(history.stamps_ns)
    found = poses[-len(stamps_ns) :, :2]
    own, matched = associate(Trajectory(stamps_ns, poses[-len(stamps_ns) :]), truth)
    if not len(own):
        raise InputError(path, "expected stamps of the run, within 20 ms, got none")
    moved = align(truth.poses[matched, :2], found[own])
    aligned: Float32Array = compose(moved, truth.poses)[:, :2].astype(np.float32)
    return aligned


def _read_messages(path: Path, document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the messages of a run; none of a run that has kept none."""
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


def _read_known_map(path: Path) -> tuple[OccupancyGrid | None, list[dict[str, Any]]]:
    """Return the map of a localization from its original path; None and a message if it cannot be read."""
    try:
        return read_map(path), []
    except InputError as error:
        messages = Messages(lambda level, text: None)
        messages.report(Level.WARN, f"without the map: {error}")
        return None, messages.to_list()
