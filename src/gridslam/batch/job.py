"""One job of a batch: a function, its arguments, and the key of its result. JSON in and out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from gridslam import __version__
from gridslam.errors import ArgumentError


@final
@dataclass(frozen=True, slots=True)
class Job:
    """A call of a function in a child process.

    Attributes
    ----------
    target : str
        The function, "package.module:name", which takes a JSON object and returns one. It is called with `arguments`
        and two more: ``out``, the path of the job's folder, and ``job``, what `summary` returns. The folder is the
        function's to create, atomically; what it returns is written there as run.json, unless it has done so itself.
    arguments : dict
        JSON object.
    log : str
        Path of the log as the user gave it.
    folder : str
        Name of the job's folder below OUT, unique in a batch.
    key : str
        SHA-256 in hexadecimal of all that determines the result (see `compute_key`).
    command : str
        Name of the command, as "map".

    Raises
    ------
    ArgumentError
        `folder` is no name of a visible folder, or `target` names no function.
    """

    target: str
    arguments: dict[str, Any]
    log: str
    folder: str
    key: str
    command: str = field(default="map")

    def __post_init__(self) -> None:
        """Check the names."""
        if not self.folder or self.folder.startswith(".") or {"/", "\\", "\0"} & set(self.folder):
            raise ArgumentError("folder", "the name of a folder that begins with no point", repr(self.folder))
        module, colon, name = self.target.partition(":")
        if not (module and colon and name):
            raise ArgumentError("target", "package.module:function", repr(self.target))

    def summary(self) -> dict[str, Any]:
        """Return the entry ``job`` of run.json: its key identifies the result of a finished job."""
        return {"key": self.key, "command": self.command, "log": self.log, "folder": self.folder}


def compute_key(command: str, log: str, parameters: Mapping[str, Any]) -> str:
    """Key of a result: SHA-256 of the command, the log, the effective parameters and the version of gridslam.

    Parameters
    ----------
    command : str
        Name of the command.
    log : str
        What identifies the content of the log: its size and time of modification, or its SHA-256.
    parameters : mapping
        JSON values of all else that determines the result: the configuration, the seed, the states of further files.
    """
    content = {"command": command, "log": log, "parameters": parameters, "version": __version__}
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()
