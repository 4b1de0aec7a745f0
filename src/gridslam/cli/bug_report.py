"""Write a report of an unexpected exception to a file, and name the file in one line; imported only then."""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import traceback
from collections.abc import Iterator
from importlib import metadata

from gridslam import __version__
from gridslam.io.remote import mask_urls

_LIBRARIES = "click", "numpy", "scipy", "pillow", "pydantic", "rosbags"
_MOST_LETTERS = 500
"""Maximum length of the quoted message of an exception, which may contain text of the input."""


def write_report(error: BaseException) -> str:
    """Write versions, command and traceback to a temporary file, and return one line that names it.

    No data are in it, and the URLs in it are without credentials.
    """
    kind = f"{type(error).__name__}: {' '.join(str(error).split())[:_MOST_LETTERS]}".rstrip(": ")
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="gridslam-bug-", suffix=".txt", encoding="utf-8", errors="backslashreplace", delete=False
        ) as file:
            file.writelines(f"{line}\n" for line in _lines(error))
    except OSError as problem:
        return mask_urls(f"this is a bug, please report it: {kind} (no file for a report could be written: {problem})")
    return mask_urls(f"this is a bug, please report it with the file {file.name}: {kind}")


def _lines(error: BaseException) -> Iterator[str]:
    yield f"gridslam {__version__}, Python {platform.python_version()}, {platform.platform()}"
    yield ", ".join(f"{name} {_version(name)}" for name in _LIBRARIES)
    yield f"command: {mask_urls(shlex.join(sys.argv))}"
    yield f"encoding: {sys.getfilesystemencoding()}"
    yield ""
    for text in traceback.format_exception(error):
        for line in text.rstrip("\n").split("\n"):
            yield mask_urls(line[:_MOST_LETTERS])


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "absent"
