"""Files of plain arrays and texts without pickle: NumPy's .npz, checked by zip's checksums."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError, ConfigurationError, InputError, describe_failure
from gridslam.io.limits import UnpackingLimit, require_memory
from gridslam.io.output import write_atomically
from gridslam.io.text import open_for_reading, refuse_unreadable

Arrays: TypeAlias = Mapping[str, NDArray[Any]]

_GENERATORS = {"PCG64": np.random.PCG64, "PCG64DXSM": np.random.PCG64DXSM}
"""Bit generators whose state is plain integers; the first is that of `numpy.random.default_rng`."""


def write_arrays(path: str | Path, arrays: Arrays) -> None:
    """Write arrays to a file; it appears under its name once it is whole.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with write_atomically(path) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(values), allow_pickle=False)


def read_arrays(path: str | Path, schema: str, what: str) -> dict[str, NDArray[Any]]:
    """Return all arrays of an .npz without pickles.

    Raises InputError where the file is not `what`, is of another schema, or unpacks to more than
    is allowed.
    """
    with open_for_reading(path) as file, refuse_unreadable(path, what):
        with zipfile.ZipFile(file) as archive:
            _require_small(path, archive)
        file.seek(0)
        with np.load(file, allow_pickle=False) as saved:
            arrays = {name: np.asarray(saved[name]) for name in saved.files}
    found = arrays.get("schema")
    got = "none" if found is None else str(found) if found.size == 1 else f"{found.dtype} of shape {found.shape}"
    if got != schema:
        raise InputError(path, f"expected schema {schema}, got {got:.100}")
    return arrays


def _require_small(path: str | Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that claims to hold more than is allowed; no more than it claims is unpacked."""
    limit = UnpackingLimit(Path(path).stat().st_size)
    size = sum(member.file_size for member in archive.infolist())
    require_memory(path, "its content", size)
    if not limit.take(size):
        raise InputError(path, limit.problem)


@contextmanager
def name_file(path: str | Path, what: str) -> Iterator[None]:
    """Raise InputError where arrays do not make a state; some come from numbers that belong together, and do not."""
    try:
        yield
    except InputError:
        raise
    except (ArgumentError, ConfigurationError) as error:
        raise InputError(path, f"expected {what}: {error}") from None
    except Exception as error:
        problem = f"its arrays do not belong together: {describe_failure(error)}"
        raise InputError(path, f"expected {what}: {problem}") from None


def read_text_array(arrays: Arrays, name: str) -> str:
    """Give the text of an array; raises ArgumentError where there is none of this name."""
    if name not in arrays:
        raise ArgumentError("arrays", f"a text named {name}", sorted(arrays))
    return str(arrays[name])


def dump_generator(rng: np.random.Generator) -> dict[str, Any]:
    """Return state of a generator as JSON values; raises ArgumentError where it is not plain integers."""
    state: dict[str, Any] = dict(rng.bit_generator.state)
    if state["bit_generator"] not in _GENERATORS:
        raise ArgumentError("rng", f"a generator over {' or '.join(_GENERATORS)}", state["bit_generator"])
    return state


def load_generator(state: Mapping[str, Any]) -> np.random.Generator:
    """Restore a generator from its saved state; raises ArgumentError for other values."""
    try:
        bits = _GENERATORS[state["bit_generator"]]()
        bits.state = state
    except (ValueError, KeyError, TypeError) as error:
        raise ArgumentError("generator", f"the state of {' or '.join(_GENERATORS)} as JSON", error) from None
    return np.random.Generator(bits)
