"""Parameters of the node that concern sessions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from gridslam.api.beginning import Place
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.io.sessions.drives import find_floor, require_floor
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.live_autosave import AUTOSAVE, SessionFiles
from gridslam.types import FloatArray

SESSION_DEFAULTS: Final[Mapping[str, float | str]] = {
    "save": "",
    "continue": "",
    "autosave": 5.0,
    "begin_at": Place.AUTO.value,
    "begin_pose": "",
    "floor": "",
    "save_as": "",
}
"""The node's parameters that concern sessions, and their defaults: see docs/ros.md."""


def find_saved_session(name: str) -> str:
    """Give the session file that slam_toolbox's `map_file_name` names, without its suffix; empty if there is none."""
    path = Path(name) if name.endswith(".gridslam") else Path(f"{name}.gridslam")
    return str(path) if name and path.is_file() else ""


def read_session_files(values: Mapping[str, Any], out: Path | None, threads: int) -> SessionFiles:
    """Read the session that the node goes on from, and where it saves its own.

    Raises
    ------
    ConfigurationError
        A value has a wrong type or is out of range.
    InputError
        The session cannot be read.
    """
    minutes = values["autosave"]
    if isinstance(minutes, bool) or not isinstance(minutes, int | float) or not 0 <= minutes < math.inf:
        raise ConfigurationError(f"autosave: expected a number of minutes, 0 for none, got {minutes!r}")
    try:
        place = Place(values["begin_at"])
    except ValueError:
        known = ", ".join(place.value for place in Place)
        raise ConfigurationError(f"begin_at: expected one of {known}, got {values['begin_at']!r}") from None
    pose = _read_pose(values["begin_pose"])
    try:
        floor = require_floor(str(values["floor"]))
    except ArgumentError as error:
        raise ConfigurationError(str(error)) from None
    continued = None
    if values["continue"]:
        continued = Continued.read(str(values["continue"]), threads, place, pose)
        if place is Place.SAME and continued.saved.run is None:
            raise ConfigurationError("begin_at: expected a session whose last drive can go on, got a merged one")
        if pose is not None and place is Place.SAME:
            raise ConfigurationError("begin_at: the same place contradicts begin_pose")
        before = "" if continued.saved.run is None else find_floor(continued.saved.run.drives)
        if place is Place.SAME and "" not in (floor, before) and floor != before:
            raise ConfigurationError(f"floor: expected {before}, on which the robot is at the same place, got {floor}")
    elif pose is not None or place is not Place.AUTO:
        raise ConfigurationError("begin_at, begin_pose: expected a session to continue, got none")
    save = Path(str(values["save"])) if values["save"] else None
    autosave = save if out is None else out / AUTOSAVE
    return SessionFiles(continued, save, autosave if minutes else None, 60.0 * minutes, floor)


def _read_pose(value: Any) -> FloatArray | None:  # noqa: ANN401
    """Pose (3,) from a text of three numbers; None if it is empty."""
    numbers = str(value).replace(",", " ").split()
    if not numbers:
        return None
    try:
        pose = np.array([float(number) for number in numbers])
    except ValueError:
        pose = np.zeros(0)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise ConfigurationError(f"begin_pose: expected x, y in m and theta in rad, got {value!r}")
    return pose
