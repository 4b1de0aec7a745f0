"""Base of all results: a folder of files, a picture, a table, and a representation in one line."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from gridslam import __version__
from gridslam.doctor.repair import Repair, RepairedLog
from gridslam.io.log import Log
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.output import OutputFolder
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.pipeline import Stopwatch, describe_error
from gridslam.types import FloatArray, Trajectory
from gridslam.viz.notebook import Picture, encode_png

_COMPRESSION = 3  # of zlib, for pictures: 12 % larger than by 6, in two thirds of the time


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Result(ABC):
    """Result of a task; each kind adds its own values, files and picture.

    Attributes
    ----------
    stopwatch : Stopwatch
        Time spent; saving adds to it.
    failures : tuple of str
        What failed, a sentence each: scans that were skipped, or the final refinement. The result is that of all
        other scans.
    """

    schema: ClassVar[str]
    """Name and number of the form of run.json."""
    picture_name: ClassVar[str]
    """Name of the picture's file."""
    file_names: ClassVar[tuple[str, ...]]
    """Names of all files that may be written, but picture and run.json."""

    stopwatch: Stopwatch
    failures: tuple[str, ...] = ()

    if TYPE_CHECKING:  # fields of one class, properties of another

        @property
        def trajectory(self) -> Trajectory:
            """A pose for each scan or step, map frame."""
            ...

        @property
        def covariances(self) -> FloatArray | None:
            """Covariances (N, 3, 3) of the poses, if known."""

        @property
        def source(self) -> Path:
            """The log."""
            ...

    @abstractmethod
    def caption(self) -> list[str]:
        """Return lines that describe the result."""

    @abstractmethod
    def picture(self) -> Picture:
        """Draw the result."""

    @abstractmethod
    def _describe(self) -> dict[str, Any]:
        """Return content of run.json besides schema, version and times."""

    @abstractmethod
    def _write_files(self, out: OutputFolder) -> None:
        """Write the files besides picture and run.json."""

    def save(self, folder: str | Path, messages: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
        """Write all results into a folder, all or none; returns the content of run.json.

        `messages` are what the run has reported (`gridslam.messages.Messages.to_list`).

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        with OutputFolder(folder, self.all_names()) as out:
            return self.write(out, messages)

    @classmethod
    def all_names(cls) -> tuple[str, ...]:
        """Names of all files that may be written."""
        return (*cls.file_names, cls.picture_name, "run.json")

    def write(self, out: OutputFolder, messages: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json. `messages` as in `save`."""
        self.stopwatch.resume()
        self._write_files(out)
        self.stopwatch.lap("write")
        failures = [*self.failures]
        try:
            self.picture().save(out.file(self.picture_name), optimize=False, compress_level=_COMPRESSION)
        except OSError:  # the other files could not be written either
            raise
        except Exception as error:
            out.file(self.picture_name).unlink(missing_ok=True)
            failures.append(f"{self.picture_name} cannot be drawn: {describe_error(error)}")
        self.stopwatch.lap("draw")
        document = self.document() | {"failures": failures, "messages": [*messages]}
        out.write_json("run.json", document)
        return document

    def document(self) -> dict[str, Any]:
        """Build the content of run.json."""
        head = {"schema": self.schema, "version": __version__, "time": self.stopwatch.to_dict()}
        return head | self._describe() | {"failures": [*self.failures]}

    def __repr__(self) -> str:
        """Return one line."""
        return f"{type(self).__name__}({self.source.name}: {'; '.join(self.caption())})"

    def _repr_png_(self) -> bytes:
        return encode_png(self.picture())


def write_trajectory(out: OutputFolder, trajectory: Trajectory, covariances: FloatArray) -> None:
    """Write trajectory.tum and trajectory.csv."""
    write_tum(out.file("trajectory.tum"), trajectory)
    write_trajectory_csv(out.file("trajectory.csv"), trajectory, covariances)


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class ScanResult(Result):
    """Result of a log of scans.

    Attributes
    ----------
    source : Path
        The log.
    digest : str
        Its SHA-256.
    log : LogStatistics
        What was met in it.
    repair : Repair
        What was taken out of it.
    """

    source: Path
    digest: str
    log: LogStatistics
    repair: Repair

    def describe_faults(self) -> Iterator[str]:
        """Yield the faults of the log, a sentence each."""
        for fault in self.repair.describe():
            yield f"{fault}: corrected before mapping (disable with --repair none; details: gridslam doctor)"
        yield from self.log.remarks
        if self.log.truncated:
            yield f"the log is truncated after {self.log.scan_count} scans"

    def describe_input(self) -> dict[str, Any]:
        """Part `input` of run.json."""
        return {
            "path": os.fspath(self.source),
            "sha256": self.digest,
            "selection": self.log.selection,
            "duration_s": self.log.duration_s,
            "repair": asdict(self.repair) if self.repair else None,
        }


def find_repair(log: Log) -> Repair:
    """Return the repair of a log that was read."""
    return (log.repair if isinstance(log, RepairedLog) else None) or Repair()
