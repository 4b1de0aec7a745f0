"""Edits of a session's maps: they lie beside its file, and stay where the building is when the maps change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TypeAlias, final

import numpy as np

from gridslam.io.edited_maps import anchor_edit, follow_scan
from gridslam.io.edits import Edit, Edits, read_edits
from gridslam.types import Trajectory

__all__ = ["EditsBefore", "Trajectories", "find_edits", "keep_edits", "set_aside"]

Trajectories: TypeAlias = Mapping[str, Trajectory]
"""Of each drive of a map, by its name."""


def find_edits(session: str | Path) -> Path:
    """Return the file in which the edits of a session lie: ``NAME.edits.geojson`` beside ``NAME.gridslam``."""
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
        none is, it is kept as it is. One that follows no scan yet is of the newest map.

        Raises
        ------
        InputError
            The file is damaged.
        """
        if not self.path.exists():
            return []
        after = {name: path for each in maps for name, path in each.items()}
        newest = (*self.maps, *maps)[:1]
        return [
            self._keep(edit if edit.anchor is not None else anchor_edit(edit, newest[0] if newest else {}), after)
            for edit in read_edits(self.path).edits
        ]

    def _keep(self, edit: Edit, after: Trajectories) -> Edit:
        edit = replace(edit, drive=self.names.get(edit.drive, edit.drive))
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
    """Return the edits of the sessions that have become one, as they lie in its maps, to be saved beside its file."""
    return Edits(tuple(edit for source in sources for edit in source.keep(maps)), Path(session).name)


def set_aside(session: str | Path, sources: Sequence[EditsBefore]) -> None:
    """Rename edits that lie beside a session file to be written, unless they are among its sources."""
    path = find_edits(session)
    if not path.exists() or any(source.path.exists() and source.path.samefile(path) for source in sources):
        return
    numbered = (path.with_name(f"{Path(session).stem}-{number}.edits.geojson") for number in count(1))
    path.rename(next(name for name in numbered if not name.exists()))
