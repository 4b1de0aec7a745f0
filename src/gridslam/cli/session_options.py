"""Session options of `gridslam map`, and their implementation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import click
from click.core import ParameterSource

from gridslam.api.beginning import Place
from gridslam.api.mapping import MapResult
from gridslam.api.session import Session
from gridslam.config import Configuration
from gridslam.io.log import Log

_OF_THE_SESSION = ("particles", "seed", "preset", "laser", "config", "assignments", "no_loop_closure")
"""Parameters of `gridslam map` that a session has already."""
_OF_A_CONTINUATION = ("same_place", "elsewhere", "pose", "frozen")
"""Parameters of `gridslam map` that mean nothing without one."""


@final
@dataclass(frozen=True, slots=True)
class SessionOptions:
    """Options of `gridslam map` that concern sessions.

    Attributes
    ----------
    save, continued : Path or None
        Session files.
    same_place, elsewhere : bool
        Where the log begins, if that is known.
    pose : (float, float, float) or None
        About where the log begins in the session's map.
    frozen : bool
        Whether what the session has mapped stays where it is.
    name : str or None
        Of the drive.
    """

    save: Path | None
    continued: Path | None
    same_place: bool
    elsewhere: bool
    pose: tuple[float, float, float] | None
    frozen: bool
    name: str | None

    def check(self, context: click.Context) -> None:
        """Raise click.UsageError where options contradict each other."""
        if self.same_place and (self.elsewhere or self.pose is not None):
            raise click.UsageError("--same-place contradicts --elsewhere and --pose")
        for parameter in context.command.params:
            option = parameter.opts[0]
            if context.get_parameter_source(str(parameter.name)) is not ParameterSource.COMMANDLINE:
                continue
            if self.continued is None and parameter.name in _OF_A_CONTINUATION:
                raise click.UsageError(f"{option} needs --continue")
            if self.continued is not None and parameter.name in _OF_THE_SESSION:
                raise click.UsageError(f"{option} contradicts --continue: the session's own configuration is used")

    def open(self, configuration: Configuration, seed: int, threads: int) -> Session | None:
        """Give the session that the log is added to; None if none is wanted."""
        if self.continued is not None:
            return Session.open(self.continued, threads=threads)
        return None if self.save is None else Session(configuration, seed=seed, threads=threads)

    def add(self, session: Session, log: Log, **options: Any) -> MapResult:  # noqa: ANN401
        """Add a log to a session."""
        place = Place.SAME if self.same_place else Place.ELSEWHERE if self.elsewhere else Place.AUTO
        where = {"place": place, "pose": self.pose, "frozen": self.frozen, "name": self.name}
        return session.add(log, **where, **options)  # type: ignore[arg-type]

    def summarize(self, session: Session | None, result: MapResult) -> Iterator[str]:
        """Format the lines that a session adds to the summary of a run."""
        if session is None:
            return
        if session.decision is not None:
            where = "continues where the session ended" if session.is_same_place else "begins elsewhere"
            forced = " (forced)" if session.is_same_place != session.decision.is_same else ""
            yield f"{result.source.name} {where}{forced}: {session.decision.reason}"
        if self.save is not None:
            yield f"session: {self.save}, {self.save.stat().st_size / 1e6:.1f} MB"
