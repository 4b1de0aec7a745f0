"""What a log's bytes are known by in the documents of a run."""

from __future__ import annotations

import hashlib
from pathlib import Path

from gridslam.io.text import compute_sha256

__all__ = ["compute_digest"]


def compute_digest(path: str | Path) -> str:
    """SHA-256, in hexadecimal, of a file's bytes, or of what a folder holds.

    Of a folder it is the SHA-256 of lines `<SHA-256 of the file>  <path in the folder>`, as `sha256sum` writes them,
    one for each file below it that is not empty, sorted by path: where the folder stands does not matter. Raises
    InputError where there is nothing at `path` or a file cannot be read.
    """
    where = Path(path)
    if not where.is_dir():
        return compute_sha256(where)
    files = {file.relative_to(where).as_posix(): file for file in where.rglob("*") if file.is_file()}
    lines = (f"{compute_sha256(files[name])}  {name}\n" for name in sorted(files) if files[name].stat().st_size)
    return hashlib.sha256("".join(lines).encode()).hexdigest()
