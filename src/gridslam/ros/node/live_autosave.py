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

__all__ = ["AUTOSAVE", "LiveAutosave", "SessionFiles"]

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


@final
class LiveAutosave:
    """Writes the session of a live robot now and then; used by the filter's thread only.

    A file that another node has left is kept under another name, unless the session goes on from it.

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
        self._is_own = False
        if files.continued is not None and self._path.exists():
            self._is_own = os.path.samefile(files.continued.path, self._path)
        if self._path.exists() and not self._is_own:
            log(
                Level.WARN,
                f"{self._path} is the session of an earlier node, which was not ended or saved: --continue {self._path}"
                " goes on from it",
            )

    def save(self, session: Session) -> None:
        """Write the session, if there is something new and the last one is written; call between two scans."""
        if session.state is None or session.state is self._saved or self._writer.is_busy:
            return
        self._writer.report()
        try:
            now = session.to_session()
        except GridslamError:  # reported by the session: what it goes on from must not be replaced
            return
        if now is None:
            return
        self._keep_other()
        self._saved = session.state
        self._writer.write(self._path, now)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writer.close()

    def _keep_other(self) -> None:
        """Move the file that an earlier node has left to a name that is free."""
        if not self._is_own and self._path.exists():
            numbered = (self._path.with_stem(f"{self._path.stem}-{number}") for number in count(1))
            kept = next(path for path in numbered if not os.path.lexists(path))
            self._path.rename(kept)
            self._log(Level.WARN, f"the earlier node's {self._path} is kept as {kept}")
        self._is_own = True
