"""Suites: the same logs by several variants and seeds, so that versions and systems can be compared."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, final

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gridslam.batch.manifest import Entry
from gridslam.config.tables import parse_toml
from gridslam.errors import ArgumentError, ConfigurationError, GridslamError, InputError
from gridslam.io.datasets import fetch_dataset, find_dataset
from gridslam.io.text import read_text

__all__ = ["PUBLIC_SUITE", "Suite", "SuiteLog", "System", "Variant", "load_suite"]

PUBLIC_SUITE: Final = "public"
"""Name of the suite that comes with the package."""

_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
_STRICT = ConfigDict(extra="forbid", frozen=True)


@final
class SuiteLog(BaseModel):
    """A log of a suite: its name, its file, and a file of relations or a true trajectory, if there is one."""

    model_config = _STRICT

    name: _Name
    file: str
    reference: str | None = None


@final
class Variant(BaseModel):
    """A way in which each log is mapped: its name, and options of `gridslam map` by their long names."""

    model_config = _STRICT

    name: _Name
    options: dict[str, str] = Field(default_factory=dict)


@final
class System(BaseModel):
    """Another system: its name, and where its trajectories are, with ``{log}`` for the name of a log (TUM format)."""

    model_config = _STRICT

    name: _Name
    trajectories: str


@final
class Suite(BaseModel):
    """Logs, variants and seeds; a TOML file.

    Attributes
    ----------
    seeds : int, [1, 1000]
        Each log is mapped with the seeds 0, 1, ...
    logs, variants, systems : tuple
        What is compared.
    """

    model_config = _STRICT

    seeds: Annotated[int, Field(ge=1, le=1000)] = 10
    logs: Annotated[tuple[SuiteLog, ...], Field(min_length=1)]
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)] = (Variant(name="default"),)
    systems: tuple[System, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> Suite:
        for kind in (self.logs, self.variants, self.systems):
            listed = [each.name for each in kind]
            twice = {name for name in listed if listed.count(name) > 1}
            if twice:
                raise ValueError(f"the name {min(twice)!r} is given twice")
        return self

    def find(self, folders: Sequence[Path], cache: Path | None = None) -> tuple[list[Entry], list[str]]:
        """Find the logs, and list the runs.

        Parameters
        ----------
        folders : sequence of Path
            Where the files are; without folders the logs that `gridslam dataset` knows are downloaded.
        cache : Path, optional
            Where downloaded logs are kept; needed without folders.

        Returns
        -------
        entries : list of Entry
            Each variant and seed of each log that there is, all variants of a seed together; named LOG-VARIANT-seedN.
        absent : list of str
            What there is not, a sentence each.

        Raises
        ------
        InputError
            There is none of the logs.
        """
        found: list[tuple[SuiteLog, Path, Path | None]] = []
        absent: list[str] = []
        for log in self.logs:
            path, problem = _locate(log.file, folders, cache)
            if path is None:
                absent.append(f"{log.name}: {problem}")
                continue
            reference = None if log.reference is None else _locate(log.reference, [*folders, path.parent], None)[0]
            if log.reference is not None and reference is None:
                absent.append(f"{log.name}: no {log.reference}, so that it is mapped without errors")
            found.append((log, path.absolute(), reference and reference.absolute()))
        if not found:
            raise InputError(folders[0] if folders else PUBLIC_SUITE, f"none of the suite's logs: {'; '.join(absent)}")
        entries = [
            Entry(
                str(path),
                str(path),
                f"{log.name}-{variant.name}-seed{seed}",
                None if reference is None else str(reference),
                variant.options | {"seed": str(seed)},
                f"variant {variant.name}",
            )
            for seed in range(self.seeds)
            for log, path, reference in found
            for variant in self.variants
        ]
        return entries, absent


def load_suite(name: str) -> Suite:
    """Load the suite of the package, `PUBLIC_SUITE`, or that of a TOML file.

    Raises
    ------
    InputError
        There is no such file, or it is no suite: names the key.
    """
    is_public = name == PUBLIC_SUITE
    text = (files("gridslam.batch") / "suites" / "public.toml").read_text("utf-8") if is_public else read_text(name)
    try:
        return Suite.model_validate(parse_toml(text))
    except ConfigurationError as error:
        raise InputError(name, str(error)) from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "suite"
        raise InputError(name, f"{where}: {re.sub('^Value error, ', '', first['msg'])}") from None


def _locate(file: str, folders: Sequence[Path], cache: Path | None) -> tuple[Path | None, str]:
    """Return path of a file in the folders, or downloaded; else why there is none."""
    for folder in folders:
        if (folder / file).exists():
            return folder / file, ""
    if folders or cache is None:
        return None, f"no {file} in {', '.join(map(str, folders)) or 'any folder'}"
    try:
        return fetch_dataset(find_dataset(file.partition(".")[0]).name, cache), ""
    except ArgumentError:
        return None, f"{file} is none of those that gridslam dataset knows"
    except GridslamError as error:
        return None, str(error)
