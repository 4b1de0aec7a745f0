"""What people and programs ask a running node for: to save and to load."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import numpy as np

from gridslam.api.beginning import Place
from gridslam.errors import ArgumentError, GridslamError, InputError, OutputError
from gridslam.io.maps import write_map
from gridslam.pipeline import describe_error
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.grid_input import pose_of
from gridslam.ros.node.messages import Level
from gridslam.types import FloatArray

Answer: TypeAlias = tuple[bool, str]
"""Whether it succeeded, and a message."""

_SUFFIX: Final = ".gridslam"
_FAILED: Final = 255
_INVALID_NAME: Final = 1
_UNREADABLE: Final = 3


class MatchType(IntEnum):
    """Where the robot is in a session that is loaded, by slam_toolbox's numbers."""

    UNSET = 0
    START_AT_FIRST_NODE = 1
    START_AT_GIVEN_POSE = 2


@final
class SessionServices:
    """Serves requests in the transport's threads; the filter waits only while tables are copied.

    Parameters
    ----------
    core : NodeCore
        The node.
    folder : Path
        Where to save what is asked for without a name.
    log : callable
        Reports to the user.

    Attributes
    ----------
    save_as : str
        Name of the session, and of the map, for requests that cannot name one; empty: in the folder.
    """

    def __init__(self, core: NodeCore, folder: Path, log: Callable[[Level, str], None]) -> None:
        self.save_as = ""
        self._core = core
        self._folder = folder
        self._log = log

    def standard(self) -> dict[str, tuple[str, Callable[[Any], Answer]]]:
        """Services of std_srvs by name: their types, and what serves a request."""
        return {
            "~/save": ("std_srvs/Trigger", lambda request: self.answer(self.save)),
            "~/serialize_map": ("std_srvs/Trigger", lambda request: self.answer(self.serialize, self.save_as)),
            "~/deserialize_map": ("std_srvs/Trigger", lambda request: self.answer(self.deserialize, self.save_as)),
            "~/save_map": ("std_srvs/Trigger", lambda request: self.answer(self.save_map, self.save_as)),
        }

    def of_slam_toolbox(self) -> dict[str, tuple[str, Callable[[Any], Sequence[Any]]]]:
        """Services of slam_toolbox by name: their types, and what serves a request."""

        def write(serve: Callable[[str], str], name: str) -> tuple[int]:
            return (0 if self.answer(serve, name)[0] else _FAILED,)

        def deserialize(request: Any) -> tuple[int]:  # noqa: ANN401
            try:
                match = MatchType(request.match_type)
                self.deserialize(request.filename, match, pose_of(request.initial_pose))
            except (GridslamError, ValueError) as error:
                self._refuse(error)
                named = isinstance(error, InputError) and request.filename
                return (_UNREADABLE if named else _INVALID_NAME,)
            return (0,)

        def pause(request: Any) -> tuple[bool]:  # noqa: ANN401
            self._core.pause(not self._core.is_paused)
            return (True,)

        def reset(request: Any) -> tuple[int]:  # noqa: ANN401
            self._core.reset()
            self._core.pause(bool(getattr(request, "pause_new_measurements", False)))
            return (0,)

        return {
            "slam_toolbox/serialize_map": (
                "slam_toolbox/SerializePoseGraph",
                lambda request: write(self.serialize, request.filename),
            ),
            "slam_toolbox/deserialize_map": ("slam_toolbox/DeserializePoseGraph", deserialize),
            "slam_toolbox/save_map": ("slam_toolbox/SaveMap", lambda request: write(self.save_map, request.name.data)),
            "slam_toolbox/pause_new_measurements": ("slam_toolbox/Pause", pause),
            "slam_toolbox/clear_changes": ("slam_toolbox/Clear", lambda request: ()),  # nobody moves nodes by hand
            "slam_toolbox/reset": ("slam_toolbox/Reset", reset),
        }

    def save(self) -> str:
        """Write what `gridslam map` writes to the folder; returns what was done. Raises GridslamError."""
        document = self._core.save(self._folder)
        return f"results of {document['scans']['read']} scans saved: {self._folder.resolve()}"

    def serialize(self, name: str = "") -> str:
        """Write the session to NAME.gridslam; returns what was done. Raises GridslamError where it cannot be."""
        path = self._session_path(name)
        copied = self._core.copy_session()
        with _writing(path):
            copied.save_session(path)
        return f"session saved: {path.resolve()}"

    def deserialize(self, name: str = "", match: MatchType = MatchType.UNSET, pose: FloatArray | None = None) -> str:
        """Go on from NAME.gridslam instead of what was mapped.

        Parameters
        ----------
        name : str
            Of the session.
        match : MatchType
            At the first node and at a given pose, the robot is looked for about `pose` (3,), which of the first node
            is the origin; unset, the first scan decides.
        pose : (3,) float64, optional
            Of the robot in the session's map; the origin if it is needed and not given.

        Raises
        ------
        GridslamError
            The session cannot be read.
        """
        path = self._session_path(name)
        place, begin = Place.AUTO, None
        if match is not MatchType.UNSET:
            is_origin = pose is None or match is MatchType.START_AT_FIRST_NODE
            place, begin = Place.ELSEWHERE, np.zeros(3) if is_origin else pose
        continued = Continued.read(path, self._core.settings.threads, place, begin)
        self._core.ask(lambda: self._core.begin_session(continued))
        return f"going on from {path}"

    def save_map(self, name: str = "") -> str:
        """Write the map as it is to NAME.yaml and NAME.pgm. Raises GridslamError where there is none."""
        path = Path(name).expanduser() if name else self._folder / "map"
        yaml = path.with_name(f"{path.name.removesuffix('.yaml')}.yaml")
        state = self._core.copy_session().beginning.run.state
        assert state is not None
        with _writing(yaml):
            write_map(yaml, state.maps.occupancy(state.best))
        return f"map saved: {yaml.resolve()}"

    def _session_path(self, name: str) -> Path:
        path = Path(name).expanduser() if name else self._folder / f"session{_SUFFIX}"
        return path if path.suffix == _SUFFIX else path.with_name(path.name + _SUFFIX)

    def answer(self, serve: Callable[..., str], *arguments: object) -> Answer:
        """Serve a request, which raises GridslamError where it cannot be served, and report what came of it."""
        try:
            done = serve(*arguments)
        except GridslamError as error:
            self._refuse(error)
            return False, str(error)
        self._log(Level.OK, done)
        return True, done

    def _refuse(self, error: Exception) -> None:
        problem = str(error) if isinstance(error, GridslamError) else describe_error(error)
        if isinstance(error, OutputError):
            self._log(Level.ERROR, f"request failed: {problem}")
        else:
            self._log(Level.WARN, f"request refused: {problem}")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Make the folder of a file that somebody asks for.

    Raises ArgumentError where the folder cannot be made, OutputError where the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError("name", "a file that can be written", f"{path}: {error.strerror or error}") from None
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
