"""Autosave of the node: what a killed node has mapped is lost for the last few minutes at most."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import final

from gridslam.errors import GridslamError
from gridslam.io.sessions.background_writer import BackgroundWriter
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.mapping_session import Session
from gridslam.ros.node.messages import Level

AUTOSAVE = "autosave.gridslam"
"""Name of the file in the output folder."""


@final
@dataclass(frozen=True, slots=True)
class SessionFiles:
    """Where a mapping session comes from and where it is saved.

    Attributes
    ----------
    continued : Continued or None
        What the first session goes on from.
    save : Path or None
        Written at the end.
    autosave : Path or None
        Written now and then.
    autosave_period_s : float, s, > 0
        Time between two of them.
    """

    continued: Continued | None = None
    save: Path | None = None
    autosave: Path | None = None
    autosave_period_s: float = 300.0

    @property
    def path(self) -> Path | None:
        """File of the session that a drive after a jump of time belongs to; None if none is saved."""
        return self.save or (self.continued and self.continued.path) or self.autosave


@final
class LiveAutosave:
    """Writes the session of a live robot now and then; used by the filter's thread only.

    A file of another session is kept under another name, unless the session goes on from it.

    Parameters
    ----------
    files : SessionFiles
        Where, and how often.
    log : callable
        Reports to the user.
    """

    def __init__(self, files: SessionFiles, log: Callable[[Level, str], None]) -> None:
        assert files.autosave is not None
        self._path = files.autosave
        self._log = log
        self._writer = BackgroundWriter(lambda problem: log(Level.ERROR, f"the session cannot be saved: {problem}"))
        self._saved: object = None
        self._session: Session | None = None  # whose file it is
        self._is_kept = False
        if self._path.exists() and not _is_same_file(files.continued, self._path):
            log(
                Level.WARN,
                f"{self._path} is the session of an earlier node, which was not ended or saved: --continue {self._path}"
                " goes on from it",
            )

    def save(self, session: Session, *, wait: bool = False) -> None:
        """Write the session, if there is something new and the last one is written; call between two scans.

        `wait`: until what earlier drives have left is at hand.
        """
        if session.state is None or session.state is self._saved or self._writer.is_busy:
            return
        self._writer.report()
        try:
            now = session.to_session(wait=wait)
        except GridslamError:  # reported by the session: what it goes on from must not be replaced
            return
        if now is None:
            return
        if session is not self._session and not self._is_kept:
            keep_other(self._path, session.continued, self._log)
        self._session, self._saved, self._is_kept = session, session.state, False
        self._writer.write(self._path, now)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writer.close()

    def note_continued(self) -> None:
        """Note that the next session holds the one so far: its file may replace that one's."""
        self._is_kept = self._session is not None


def keep_other(path: Path, continued: Continued | None, log: Callable[[Level, str], None]) -> None:
    """Move a session file that is in the way to a name that is free, unless the new session goes on from it."""
    if not path.exists() or _is_same_file(continued, path):
        return
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(1))
    kept = next(name for name in numbered if not os.path.lexists(name))
    path.replace(kept)
    log(Level.WARN, f"the earlier session {path} is kept as {kept}")


def _is_same_file(continued: Continued | None, path: Path) -> bool:
    """Whether a session goes on from this file."""
    if continued is None or not continued.is_in_file:
        return False
    return continued.path.exists() and path.exists() and continued.path.samefile(path)
