"""Sessions: maps that are saved, continued with other logs, relocalized in, and merged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from gridslam import __version__
from gridslam.api.beginning import (
    Beginning,
    Place,
    PlaceDecision,
    decide_place,
    locate_in,
    restart_at_same_place,
)
from gridslam.api.mapping import MapResult, map_log
from gridslam.arguments import freeze, require_seed, require_threads
from gridslam.checked import checked
from gridslam.config import Configuration, build
from gridslam.doctor.repair import open_repaired
from gridslam.errors import ArgumentError
from gridslam.grid.tiles import TiledGrid
from gridslam.io.log import LogOptions, LogSource
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.drives import Drive, DrivenLog, SavedPiece, choose_name, choose_names
from gridslam.io.sessions.session_file import SavedRun, SavedSession, read_session, write_session
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam, refine_piece
from gridslam.slam.full_slam.full_trajectory import full_trajectories
from gridslam.slam.full_slam.merging import merge_pieces
from gridslam.types import FloatArray, OccupancyGrid, Trajectory


@final
class _Map(NamedTuple):
    """A refined piece and its map."""

    piece: SavedPiece
    tiled_map: TiledGrid
    poses: FloatArray | None = None
    """Where all scans of its drives lie (N, 3); None where that follows from the key scans."""

    def prepare(self, configuration: Configuration, *, frozen: bool) -> SavedPiece:
        """Give the piece as a later drive is joined with it: thinned, and frozen if that is wanted."""
        piece = self.piece
        if frozen:
            bent = full_trajectories(piece.piece.poses, piece.tracked_scans) if self.poses is None else self.poses
            piece = piece.freeze(bent)
        return piece.thin(configuration.mapper)

    @classmethod
    def draw(cls, piece: SavedPiece, configuration: Configuration) -> _Map:
        """Build the map of a piece."""
        return cls(piece, piece.piece.build_map(configuration.mapper).tiled(0))


@final
@checked
class Session:
    """A map that grows over logs, days and robots.

    Parameters
    ----------
    configuration : Configuration, optional
        Of all drives; `Configuration()` if not given. With loop closure, which relocalization needs.
    seed : int, >= 0
        Of the first drive; drive k has seed + k.
    threads : int, >= 1
        Threads of the kernels; never changes a result.

    Attributes
    ----------
    decision : PlaceDecision or None
        Whether the log that was added last continued where the one before it ended, and why; None if there was none
        before.
    is_same_place : bool
        Whether it continued there, be it decided or given.
    """

    def __init__(self, configuration: Configuration | None = None, *, seed: int = 0, threads: int = 1) -> None:
        require_seed(seed)
        require_threads(threads)
        self._saved = SavedSession(configuration or Configuration(), seed)
        self._threads = threads
        self._path: Path | None = None
        self._maps: list[_Map] | None = None
        self.decision: PlaceDecision | None = None
        self.is_same_place = False

    @classmethod
    def open(cls, path: str | Path, *, threads: int = 1) -> Session:
        """Open a session file.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is of a version that is not known.
        """
        require_threads(threads)
        self = cls.of(read_session(path, threads), threads=threads)
        self._path = Path(path)
        return self

    @classmethod
    def of(cls, saved: SavedSession, *, threads: int = 1) -> Session:
        """Continue the result of a run."""
        self = cls(saved.configuration, seed=saved.seed, threads=threads)
        self._saved = saved
        return self

    def __repr__(self) -> str:
        """Return one line."""
        names = [drive.name for drive in self._saved.drives]
        count = f"{len(names)} drive{'s' * (len(names) != 1)}"
        return f"Session({count}: {', '.join(names)})" if names else "Session(empty)"

    def _repr_png_(self) -> bytes | None:
        """Show the newest map in a notebook; None without one."""
        return self.map._repr_png_() if [*self._saved.drives] else None

    @property
    def saved(self) -> SavedSession:
        """All that a file of it holds."""
        return self._saved

    @property
    def configuration(self) -> Configuration:
        """The effective one."""
        return self._saved.configuration

    @property
    def pieces(self) -> list[SavedPiece]:
        """The pieces of the map, the newest drive's first; refined, which takes time where a log was just opened."""
        return [own.piece for own in self._refine()]

    @property
    def maps(self) -> list[TiledGrid]:
        """The maps of the pieces, in the same order."""
        return [own.tiled_map for own in self._refine()]

    @property
    def map(self) -> OccupancyGrid:
        """The map of the newest drive's piece as one array.

        Raises ArgumentError where nothing was mapped yet.
        """
        maps = self.maps
        if not maps:
            raise ArgumentError("session", "at least one log", "none")
        return maps[0].whole()

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The trajectory of each drive by its name, in the frame of its piece's map."""
        return {name: path for piece in self.pieces for name, path in piece.trajectories.items()}

    @property
    def names(self) -> list[str]:
        """A name of each map, in the same order: that of its first drive."""
        return choose_names(piece.name for piece in self.pieces)

    def add(
        self,
        log: LogSource,
        *,
        place: Place | Literal["auto", "same place", "elsewhere"] = Place.AUTO,
        pose: ArrayLike | None = None,
        frozen: bool = False,
        name: str | None = None,
        options: LogOptions | None = None,
        repair: Literal["needed", "none"] = "needed",
        **map_options: Any,  # noqa: ANN401 those of map_log
    ) -> MapResult:
        """Map a log as the continuation of this session.

        Unless the robot was moved since the last log, the filter continues as if there had been one log. Where it was,
        a new drive begins, is searched for in all that was mapped before, and is joined with it once it is certain
        where it lies; if it never is, it stays a piece of its own.

        Parameters
        ----------
        log : str, Path or Log
            The log.
        place : Place, "auto", "same place" or "elsewhere"
            Whether the robot begins where the last log has ended; decided by stamps, odometry and the first scan if
            not known.
        pose : (3,) float64, optional
            About where it begins in the map of the newest piece, within 5 m and 0.5 rad: then it is elsewhere.
        frozen : bool
            Whether what was mapped before stays where it is, to the last bit: a new drive begins, and is aligned with
            it. What was frozen once stays so.
        name : str, optional
            Of a new drive; that of the log if not given.
        options, repair
            As in `map_log`.
        **map_options
            Further arguments of `map_log`, but its configuration, seed, particles, preset and laser.

        Raises
        ------
        ArgumentError
            There is no drive to continue at the same place, or there is no piece in which the pose could be.
        InputError
            The log cannot be read.
        """
        where = Place(place)
        begin = None if pose is None else freeze(pose, np.float64, (3,), "pose")
        source = open_repaired(log, options, repair)
        first = next(iter(source))
        map_options.pop("keep_particles", None)
        name = name or source.path.name.partition(".")[0]
        self._decide(first, Place.ELSEWHERE if begin is not None or frozen else where)
        begun = self._begin(first, begin, frozen, name)
        result = map_log(
            source,
            configuration=self.configuration,
            seed=self._saved.seed,
            threads=self._threads,
            repair="none",
            beginning=begun,
            keep_particles=True,
            **map_options,
        )
        self.keep(result)
        return result

    def keep(self, result: MapResult) -> None:
        """Continue from the result of a run."""
        self._saved = result.to_session()
        self._maps = None  # without loop closure there are no pieces
        if result.map_piece is not None:
            newest = _Map(result.map_piece, result.tiled_map, result.poses_by_drive)
            self._maps = [newest, *(_Map.draw(piece, self.configuration) for piece in result.pieces)]

    def merge(self, *others: Session, on_progress: Callable[[], None] = lambda: None) -> FullSlam:
        """Merge other sessions into this one: pieces that show the same places become one map.

        The result does not depend on the order. What shows nothing in common stays apart (see `pieces`). The filter
        ends: the next log is a new drive.

        Returns
        -------
        FullSlam
            Of the largest piece.

        Raises
        ------
        ArgumentError
            A session is of another configuration, or without loop closure, or all are empty, or two hold the same log:
            a session that continues another holds its drives.
        """
        sessions = [self, *others]
        for other in others:
            if other.configuration != self.configuration:
                raise ArgumentError("others", "sessions of the same configuration", "another one")
        closure = self.configuration.loop_closure
        if closure is None:
            raise ArgumentError("sessions", "ones with loop closure, to recognize places", "ones without")
        _require_different_logs(sessions)
        owned = sorted((piece for own in sessions for piece in own.pieces), key=_order)
        if not owned:
            raise ArgumentError("sessions", "one with a drive at least", "empty ones")
        pieces = _name_apart(owned)
        mapper = self.configuration.mapper
        merged = merge_pieces([piece.piece for piece in pieces], mapper, closure, on_progress)
        groups = [SavedPiece(group.piece, _follow([pieces[number] for number in group.members])) for group in merged]
        groups.sort(key=lambda piece: -len(piece.piece))
        largest = groups[0]
        full = refine_piece(largest.piece, largest.tracked_scans, mapper, closure, on_progress)
        first = _Map(SavedPiece(full.piece or largest.piece, largest.drives), full.tiled_map, full.poses)
        self._maps = [first, *(_Map.draw(piece, self.configuration) for piece in groups[1:])]
        self._saved = SavedSession(self.configuration, self._saved.seed, None, tuple(self.pieces))
        return full

    def save(self, path: str | Path | None = None) -> None:
        """Write a session file; where it was opened or saved last if no path is given.

        Raises
        ------
        ArgumentError
            No path is known.
        OutputError
            The file cannot be written.
        """
        target = path or self._path
        if target is None:
            raise ArgumentError("path", "a path: the session was never saved", None)
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        self._saved = replace(self._saved, written=now, version=__version__)
        write_session(target, self._saved)
        self._path = Path(target)

    def _decide(self, first: Measurement, place: Place) -> None:
        """Decide whether the log continues at the end of the last one."""
        saved = self._saved
        self.decision = None
        if saved.run is not None:
            self.decision = decide_place(saved.run, build(saved.configuration, self._threads), first)
        elif place is Place.SAME:
            raise ArgumentError("place", "a session whose last drive can be continued", "one without")
        is_same = self.decision is not None and self.decision.is_same
        self.is_same_place = is_same if place is Place.AUTO else place is Place.SAME

    def _begin(self, first: Measurement, pose: FloatArray | None, frozen: bool, name: str) -> Beginning:
        """Return the beginning of the run of a log."""
        saved = self._saved
        if self.is_same_place and saved.run is not None:
            run = saved.run.snapshot()  # that of the session is kept as it is
            pieces = saved.pieces
            if run.state is not None and self.decision is not None and not self.decision.is_same:
                restart_at_same_place(run.state, first)
        else:
            pieces = tuple(own.prepare(saved.configuration, frozen=frozen) for own in self._refine())
            if pose is not None and not pieces:
                raise ArgumentError("pose", "a session in whose map the robot can begin", "an empty one")
            drives = [drive.name for drive in saved.drives]
            rng = np.random.default_rng(saved.seed + len(drives))
            run = SavedRun(rng, name=choose_name(name, drives))
        return Beginning(run, pieces, locate_in(pieces, self.configuration, run, pose))

    def _refine(self) -> list[_Map]:
        """Refine the newest drive's piece, and build the maps of all."""
        if self._maps is None:
            saved = self._saved
            mapper = saved.configuration.mapper
            self._maps = [_Map.draw(piece, saved.configuration) for piece in saved.pieces]
            if saved.run is not None and saved.run.state is not None:
                drives = saved.run.drives
                scans = [drive.scans for drive in drives]
                full = full_slam(saved.run.state, scans, mapper, saved.configuration.loop_closure)
                if full.piece is None:
                    raise ArgumentError("session", "one that was mapped with loop closure", "one without")
                self._maps.insert(0, _Map(SavedPiece(full.piece, drives), full.tiled_map, full.poses))
        return self._maps


def _require_different_logs(sessions: Sequence[Session]) -> None:
    """Check that no two sessions hold the same log, wherever it lay: its drive would be in the map twice."""
    seen = set[DrivenLog]()
    for own in sessions:
        logs = {replace(log, path=""): log for drive in own._saved.drives for log in drive.logs}
        if common := seen & logs.keys():
            raise ArgumentError("others", "sessions without a log in common", logs[common.pop()].path)
        seen |= logs.keys()


def _order(piece: SavedPiece) -> tuple[Any, ...]:
    """Return the sort key of a piece, so that results do not depend on the order in which pieces are given."""
    first = int(piece.stamps_ns[0])
    logs = [(log.sha256, log.path) for drive in piece.drives for log in drive.logs]
    return first, -len(piece.piece), logs, piece.piece.poses.tobytes()


def _name_apart(pieces: Sequence[SavedPiece]) -> list[SavedPiece]:
    """Give drives of the same name in several pieces names of their own."""
    names = iter(choose_names(drive.name for piece in pieces for drive in piece.drives))
    return [
        SavedPiece(piece.piece, tuple(replace(drive, name=next(names)) for drive in piece.drives)) for piece in pieces
    ]


def _follow(members: Sequence[SavedPiece]) -> tuple[Drive, ...]:
    """Return the drives of several pieces whose key scans follow one another."""
    drives = []
    first = 0
    for member in members:
        for drive in member.drives:
            drives.append(replace(drive, scans=drive.scans._replace(keys=first + drive.scans.keys)))
        first += len(member.piece)
    return tuple(drives)
