"""One job of a batch: a command line, and the key of its result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from gridslam import __version__
from gridslam.errors import ArgumentError


@final
@dataclass(frozen=True, slots=True)
class Job:
    """A command line of gridslam that a child process runs.

    Attributes
    ----------
    words : tuple of str
        The command line after `gridslam`, without ``--out`` and ``--json``.
    log : str
        Path of the log as the user gave it.
    folder : str
        Name of the job's folder below OUT, unique in a batch.
    key : str
        SHA-256 in hexadecimal of all that determines the result (see `compute_key`).
    command : str
        Name of the command, as "map".
    configuration : str
        TOML that the command gets as ``--config``; empty for none.
    scoring : tuple of str
        Reference and options with which `gridslam evaluate` scores the trajectory; empty where it is not scored.

    Raises
    ------
    ArgumentError
        `folder` is no name of a visible folder.
    """

    words: tuple[str, ...]
    log: str
    folder: str
    key: str
    command: str = "map"
    configuration: str = ""
    scoring: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the name."""
        if not self.folder or self.folder.startswith(".") or {"/", "\\", "\0"} & set(self.folder):
            raise ArgumentError("folder", "the name of a folder that begins with no point", repr(self.folder))


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
