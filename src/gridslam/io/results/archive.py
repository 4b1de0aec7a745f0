"""Archives of plain arrays (.npz without pickles) under a named schema."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.output import write_atomically
from gridslam.io.text import open_for_reading

__all__ = ["read_arrays", "write_arrays"]


def read_arrays(path: str | Path, schema: str, what: str) -> dict[str, NDArray[Any]]:
    """All arrays of an archive; raises InputError where the file is not `what` or is of another schema."""
    with open_for_reading(path) as file:
        try:
            with zipfile.ZipFile(file):
                file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise InputError(path, f"expected {what}, got: {error}") from None
    got = str(arrays.get("schema", "none"))
    if got != schema:
        raise InputError(path, f"expected schema {schema}, got {got}")
    return arrays


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write an archive, its schema among the arrays; it appears under its name once it is whole.

    Raises OutputError where it cannot be written.
    """
    with write_atomically(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)
