"""Edits of a session's maps: they lie beside its file, and stay where the building is when the maps change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TypeAlias, final

import numpy as np

from gridslam.errors import InputError, OutputError
from gridslam.io.edited_maps import anchor_edit, follow_scan
from gridslam.io.edits import Edit, Edits, read_edits, write_edits
from gridslam.io.sessions.session_file import SavedSession, write_session
from gridslam.types import Trajectory

Trajectories: TypeAlias = Mapping[str, Trajectory]
"""Of each drive of a map, by its name."""


def find_edits(session: str | Path) -> Path:
    """Return the path of a session's edits: ``NAME.edits.geojson`` beside ``NAME.gridslam``."""
    return Path(session).with_suffix(".edits.geojson")


@final
@dataclass(frozen=True, slots=True)
class EditsBefore:
    """The edits of a session as it was opened.

    Attributes
    ----------
    path : Path
        Their file, which is read when they are asked for: people edit while a robot drives.
    maps : tuple of mappings of str to Trajectory
        Where the drives of each map lay before others were added, the newest map first; empty where none were.
    names : mapping of str to str
        Of drives that have got other names.
    """

    path: Path
    maps: tuple[Trajectories, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)

    def note(self, maps: Sequence[Trajectories]) -> EditsBefore:
        """Return the same with the maps of the session as it was opened, unless they were noted before."""
        return self if self.maps else replace(self, maps=tuple(maps))

    def rename(self, names: Mapping[str, str]) -> EditsBefore:
        """Return the same, where drives have got other names once more."""
        maps = tuple({names.get(name, name): path for name, path in each.items()} for each in self.maps)
        names = {**names, **{old: names.get(new, new) for old, new in self.names.items()}}
        return replace(self, maps=maps, names=names)

    def keep(self, maps: Sequence[Trajectories]) -> list[Edit]:
        """Return the edits where the maps of the session are now, by the names that its drives have now.

        An edit follows its scan. Where that was left out it follows the nearest one of the same map that is left; where
        none is, it is kept as it is. One that follows no scan yet is of the map of its drive; without a drive of the
        newest one.

        Raises
        ------
        InputError
            The file is damaged.
        """
        if not self.path.exists():
            return []
        after = {name: path for each in maps for name, path in each.items()}
        return [self._keep(edit, after, self.maps or maps) for edit in read_edits(self.path).edits]

    def _keep(self, edit: Edit, after: Trajectories, drawn_on: Sequence[Trajectories]) -> Edit:
        edit = replace(edit, drive=self.names.get(edit.drive, edit.drive))
        if edit.anchor is None:
            own = (each for each in drawn_on if not edit.drive or edit.drive in each)
            edit = anchor_edit(edit, next(own, {}))
        moved = follow_scan(edit, after)
        for before in self.maps if moved is None else ():
            was = follow_scan(edit, before)
            if was is not None:
                left = {name: _select(path, after[name]) for name, path in before.items() if name in after}
                moved = follow_scan(anchor_edit(replace(was, anchor=None, drive=""), left), after)
                break
        return moved or edit


def _select(before: Trajectory, after: Trajectory) -> Trajectory:
    """Return the scans of a drive that were not left out since."""
    is_left = np.isin(before.stamps_ns, after.stamps_ns)
    return Trajectory(before.stamps_ns[is_left], before.poses[is_left])


def keep_edits(sources: Sequence[EditsBefore], maps: Sequence[Trajectories], session: str | Path) -> Edits:
    """Return the edits of merged sessions, moved to the maps of the result, to be saved beside its file."""
    return Edits(tuple(edit for source in sources for edit in source.keep(maps)), Path(session).name)


def write_session_and_edits(
    target: str | Path,
    saved: SavedSession,
    sources: Sequence[EditsBefore],
    list_maps: Callable[[], Sequence[Trajectories]] = tuple,
) -> None:
    """Write a session file, and before it the edits of the sessions that it is made of beside it.

    A process that is killed between the two leaves edits that follow the scans of the session of before, too.

    Parameters
    ----------
    target : str or Path
        The file.
    saved : SavedSession
    sources : sequence of EditsBefore
        Their edits are read now.
    list_maps : callable
        Gives the maps of the session, in which the edits are moved; is called where there are edits. Without maps they
        are moved when the session is opened.

    Raises
    ------
    OutputError
        The file cannot be written, or the edits are damaged; then the session is written alone.
    """
    problem = None
    path = find_edits(target)
    if any(source.path.exists() for source in sources):
        try:
            edits = keep_edits(sources, list_maps(), target)
            if not (path.exists() and path.read_bytes() == edits.to_text().encode()):
                write_edits(path, edits)
        except InputError as error:
            problem = error
    write_session(target, saved)
    if problem is not None:
        raise OutputError(f"{target}: is written without its edits: {problem}")


def set_aside(session: str | Path, sources: Sequence[EditsBefore]) -> None:
    """Rename the edits beside a session file that will be written, unless they are among its sources."""
    path = find_edits(session)
    if not path.exists() or any(source.path.exists() and source.path.samefile(path) for source in sources):
        return
    numbered = (path.with_name(f"{Path(session).stem}-{number}.edits.geojson") for number in count(1))
    path.rename(next(name for name in numbered if not name.exists()))


def move_session(session: Path, target: Path) -> None:
    """Rename a session file and the edits beside it, in place of those that are there."""
    if find_edits(session).exists():
        find_edits(session).replace(find_edits(target))
    else:
        find_edits(target).unlink(missing_ok=True)
    session.replace(target)
