"""The session file NAME.gridslam: the complete state that later logs continue, in one file."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam import __version__, serialization
from gridslam.arguments import require_instance, require_seed
from gridslam.config import Configuration, dumps
from gridslam.config.configuration import loads
from gridslam.errors import ArgumentError
from gridslam.io.sessions.archive_file import (
    Arrays,
    dump_generator,
    load_generator,
    name_file,
    read_arrays,
    read_text_array,
    write_arrays,
)
from gridslam.io.sessions.drives import Drive, DrivenLog, SavedPiece
from gridslam.io.text import parse_json
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.serialization import read_array, select_part
from gridslam.slam.full_slam.full_trajectory import TrackedScans
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.map_piece import MapPiece

SESSION_SCHEMA = "gridslam.session/5"
_WHAT = "a session of gridslam"


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """The filter between two scans, and the values of its observers; continue it by `pipeline.run`.

    Attributes
    ----------
    rng : numpy.random.Generator
        Over PCG64, as from `numpy.random.default_rng`, or PCG64DXSM.
    state : GridFastSlamState or None
        The filter's state; None before the first scan. A file is written from it without consuming it.
    trajectory : TrajectoryRecorder
        The scans so far.
    statistics : StatisticsRecorder
        Counts and latencies so far.
    name : str
        Of the drive.
    logs : tuple of DrivenLog
        The logs so far.
    earlier : tuple of Drive
        The drives of the piece in which the robot was found, whose key scans come first.
    """

    rng: np.random.Generator
    state: GridFastSlamState | None = None
    trajectory: TrajectoryRecorder = field(default_factory=TrajectoryRecorder)
    statistics: StatisticsRecorder = field(default_factory=StatisticsRecorder)
    name: str = ""
    logs: tuple[DrivenLog, ...] = ()
    earlier: tuple[Drive, ...] = ()

    def snapshot(self) -> SavedRun:
        """Keep a copy for later."""
        rng, trajectory, statistics = copy.deepcopy((self.rng, self.trajectory, self.statistics))
        state = None if self.state is None else self.state.snapshot()
        return replace(self, rng=rng, state=state, trajectory=trajectory, statistics=statistics)

    def copy(self) -> SavedRun:
        """Return a copy that another thread may write while the filter continues."""
        twin = replace(self, state=None).snapshot()
        return replace(twin, state=None if self.state is None else self.state.copy())

    @property
    def drives(self) -> tuple[Drive, ...]:
        """The earlier drives, and the one so far."""
        keys = len(self.trajectory.key_scans)
        first = 0 if self.state is None else self.state.ancestry.steps - keys
        stamps_ns = self.trajectory.online_trajectory().stamps_ns
        own = Drive(self.name, self.logs, stamps_ns, self.trajectory.tracked_scans(first))
        return (*self.earlier, own)


@final
@dataclass(frozen=True, slots=True, eq=False)
class SavedSession:
    """The maps and the state of one or several drives.

    Attributes
    ----------
    configuration : Configuration
        The effective one, of all drives.
    seed : int
        Of the run.
    run : SavedRun or None
        The newest drive, which can be continued; None where pieces were merged.
    pieces : tuple of SavedPiece
        Maps of other drives, in unrelated frames.
    written : str
        Date and time in UTC, ISO 8601.
    version : str
        Version of gridslam that wrote it.
    """

    configuration: Configuration
    seed: int = 0
    run: SavedRun | None = None
    pieces: tuple[SavedPiece, ...] = ()
    written: str = ""
    version: str = __version__

    @property
    def drives(self) -> Iterator[Drive]:
        """All drives."""
        for piece in self.pieces:
            yield from piece.drives
        if self.run is not None:
            yield from self.run.drives

    def dump(self) -> dict[str, Any]:
        """Return plain arrays and texts, with copies of all values that a run may change."""
        arrays: dict[str, Any] = {"schema": np.array(SESSION_SCHEMA), "head": np.array(json.dumps(self._head()))}
        for number, piece in enumerate(self.pieces):
            arrays |= _prefix(f"pieces.{number}", serialization.to_arrays(piece.piece))
            arrays |= _dump_drives(f"pieces.{number}", piece.drives)
        if self.run is not None:
            run = self.run
            if run.state is not None:
                arrays |= _prefix("run.state", run.state.to_arrays())
            for name in ("trajectory", "statistics"):
                arrays |= _prefix(f"run.{name}", getattr(run, name).to_arrays())
            arrays |= _dump_drives("run", run.earlier)
        return arrays

    def _head(self) -> dict[str, Any]:
        head: dict[str, Any] = {
            "version": self.version,
            "written": self.written,
            "seed": self.seed,
            "configuration": dumps(self.configuration),
            "pieces": [[_describe(drive) for drive in piece.drives] for piece in self.pieces],
            "run": None,
        }
        if self.run is not None:
            head["run"] = {
                **_describe(self.run),
                "earlier": [_describe(drive) for drive in self.run.earlier],
                "generator": dump_generator(self.run.rng),
            }
        return head


@final
@dataclass(frozen=True, slots=True)
class SessionHead:
    """The content of a session file, without its arrays.

    Attributes
    ----------
    document : dict
        Version, date, seed, configuration, drives and their logs, as in the file.
    key_scans, constraints : int
        Number of key scans and of constraints, of all pieces.
    """

    document: Mapping[str, Any]
    key_scans: int
    constraints: int


def write_session(path: str | Path, session: SavedSession) -> None:
    """Write a session; the file appears under its name, in place of an earlier one, once it is whole.

    Raises
    ------
    ArgumentError
        The generator's state is not plain integers.
    ConsumedStateError
        The state was given to the filter.
    OutputError
        The file cannot be written.
    """
    write_arrays(path, session.dump())


def read_session(path: str | Path, threads: int = 1) -> SavedSession:
    """Read a session; continuing it gives the same results as a run without interruption.

    Parameters
    ----------
    path : str or Path
        What `write_session` wrote, in this version or an earlier one.
    threads : int
        Threads of the kernels; never changes a result.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, has another schema, or its arrays do not belong together.
    """
    arrays = read_arrays(path, SESSION_SCHEMA, _WHAT)
    with name_file(path, _WHAT):
        head = _parse_head(arrays)
        configuration = loads(head["configuration"], ignore_unknown=True)
        pieces = [
            _load_piece(select_part(arrays, f"pieces.{number}"), drives) for number, drives in enumerate(head["pieces"])
        ]
        run = None
        if head["run"] is not None:
            run = _load_run(select_part(arrays, "run"), head["run"], configuration, threads)
        return SavedSession(
            configuration,
            seed=int(head["seed"]),
            run=run,
            pieces=tuple(pieces),
            written=str(head["written"]),
            version=str(head["version"]),
        )


def read_head(path: str | Path) -> SessionHead:
    """Read the head of a session file, without restoring it; raises InputError as `read_session`."""
    arrays = read_arrays(path, SESSION_SCHEMA, _WHAT)
    with name_file(path, _WHAT):
        head = _parse_head(arrays)
        ends = "graph.poses", "run.state.ancestry.trunk", "run.state.ancestry.counts"
        key_scans = sum(len(values) for name, values in arrays.items() if name.endswith(ends) and "closure" not in name)
        constraints = sum(len(values) for name, values in arrays.items() if name.endswith("graph.constraints.to"))
        return SessionHead(head, key_scans, constraints)


def _parse_head(arrays: Arrays) -> dict[str, Any]:
    """Read the head; raises ArgumentError, or another error, where it does not describe drives and their logs."""
    head = parse_json(read_text_array(arrays, "head"))
    require_instance("head", head, dict)
    for name in ("version", "written", "configuration"):
        require_instance(name, head[name], str)
    require_seed(head["seed"])
    run = head["run"]
    if not all(head["pieces"]):
        raise ArgumentError("pieces", "a drive in each", "none")
    groups = head["pieces"] if run is None else [*head["pieces"], run["earlier"], [run]]
    for drive in chain.from_iterable(groups):
        require_instance("drives", drive, dict)
        require_instance("name", drive["name"], str)
        _load_logs(drive["logs"])
    return dict(head)


def _prefix(part: str, arrays: Arrays) -> dict[str, Any]:
    return {f"{part}.{name}": values for name, values in arrays.items()}


def _describe(drive: Drive | SavedRun) -> dict[str, Any]:
    return {"name": drive.name, "logs": [asdict(log) for log in drive.logs]}


def _dump_drives(part: str, drives: tuple[Drive, ...]) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for number, drive in enumerate(drives):
        own = f"{part}.drives.{number}"
        arrays[f"{own}.stamps_ns"] = drive.stamps_ns
        arrays[f"{own}.keys"] = drive.scans.keys
        arrays[f"{own}.key_from_base"] = drive.scans.key_from_base
        if drive.scans.poses is not None:
            arrays[f"{own}.poses"] = drive.scans.poses
    return arrays


def _load_drives(arrays: Arrays, heads: list[dict[str, Any]]) -> tuple[Drive, ...]:
    """Restore drives."""
    drives = []
    for number, head in enumerate(heads):
        own = select_part(arrays, f"drives.{number}")
        sizes: dict[str, int] = {}
        stamps_ns = read_array(own, "stamps_ns", np.int64, ("scans",), sizes)
        keys = read_array(own, "keys", np.int64, ("scans",), sizes)
        key_from_base = read_array(own, "key_from_base", np.float64, ("scans", 3), sizes)
        poses = read_array(own, "poses", np.float64, ("scans", 3), sizes) if "poses" in own else None
        scans = TrackedScans(keys, key_from_base, poses)
        drives.append(Drive(str(head["name"]), _load_logs(head["logs"]), stamps_ns, scans))
    return tuple(drives)


def _load_logs(logs: list[dict[str, Any]]) -> tuple[DrivenLog, ...]:
    return tuple(DrivenLog(**log) for log in logs)


def _load_piece(arrays: Arrays, heads: list[dict[str, Any]]) -> SavedPiece:
    return SavedPiece(serialization.from_arrays(MapPiece, arrays), _load_drives(arrays, heads))


def _load_run(arrays: Arrays, head: dict[str, Any], configuration: Configuration, threads: int) -> SavedRun:
    run = SavedRun(
        load_generator(head["generator"]),
        trajectory=TrajectoryRecorder.from_arrays(select_part(arrays, "trajectory")),
        statistics=StatisticsRecorder.from_arrays(select_part(arrays, "statistics")),
        name=str(head["name"]),
        logs=_load_logs(head["logs"]),
    )
    if "state.schema" not in arrays:
        return run
    state = GridFastSlamState.from_arrays(select_part(arrays, "state"), configuration.mapper, threads)
    return replace(run, state=state, earlier=_load_drives(arrays, head["earlier"]))
