"""Logs at URLs, copied to a folder of this machine; by fsspec, an extra.

Credentials in a URL, its user and its query, appear in no message and in no file (`mask_url`).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import parse_qsl, unquote, urlsplit

from gridslam.errors import GridslamError, InputError, MissingDependencyError, OutputError
from gridslam.io.output import write_atomically

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_STATE = (
    *("ETag", "etag", "LastModified", "Last-Modified", "mtime", "generation", "VersionId"),
    *("md5Hash", "crc32c", "content_md5", "Content-MD5", "Digest"),
)
"""Properties of a file's content, besides its size, that file systems may report."""
_MASK: Final = "***"
_CACHE: Final = "GRIDSLAM_CACHE"
_ORIGIN: Final = "gridslam_origin.txt"


def is_url(path: str | Path) -> bool:
    """Return whether a path is a URL, such as ``s3://bucket/log.bag``."""
    return isinstance(path, str) and _URL.match(path) is not None


def mask_url(url: str) -> str:
    """Return a URL without its credentials: user, password and the query, which holds the signature of a signed URL."""
    match = _URL.match(url)
    if match is None:
        return url
    rest = url[match.end() :]
    rest = rest.partition("#")[0]
    rest, question_mark, rest_query = rest.partition("?")
    host, slash, path = rest.partition("/")
    masked = f"{_MASK}@{host.rpartition('@')[2]}" if "@" in host else host
    is_query = question_mark and (match[0].lower().startswith("http") or "=" in rest_query)
    query = f"?{_MASK}" if is_query else question_mark + rest_query
    return f"{match[0]}{masked}{slash}{path}{query}"


def mask_urls(text: str) -> str:
    """Return a text without the credentials in its URLs."""
    return re.sub(_URL.pattern + r"\S+", lambda found: mask_url(found[0]), text)


def describe_remote(url: str) -> str:
    """Return properties that identify the content of a URL without reading it.

    Raises
    ------
    MissingDependencyError
        The library for these URLs is not installed.
    InputError
        There is no such file, or it cannot be reached.
    """
    with _translate(url):
        system, path = _connect(url)
        return _state(_find(system, path, url))


def fetch(url: str) -> Path:
    """Copy a log at a URL, a file or the folder of a ROS 2 bag, into the cache, unless it is there already.

    Parameters
    ----------
    url : str
        Where it is; credentials are those of the environment, as the libraries of fsspec expect them.

    Returns
    -------
    Path
        The copy, in GRIDSLAM_CACHE or ~/.cache/gridslam/logs.

    Raises
    ------
    MissingDependencyError, InputError
        As `describe_remote`; InputError also where the copy is not complete.
    OutputError
        The cache cannot be written.
    """
    with _translate(url):
        system, path = _connect(url)
        files = _find(system, path, url)
        origin = mask_url(url)
        name = PurePosixPath(path.rstrip("/").partition("?")[0]).name or "log"
        entry = _find_cache() / hashlib.sha256(f"{origin}\n{_state(files)}".encode()).hexdigest()[:16]
        log = entry / name
        try:
            if entry.exists() and not log.exists():
                shutil.rmtree(entry, ignore_errors=True)  # both appear at once: the copy was deleted
            if not log.exists():
                with write_atomically(entry) as partial:
                    partial.mkdir()
                    _download(system, path, files, partial / name, url)
                    (partial / _ORIGIN).write_text(origin, encoding="utf-8")
        except OutputError:
            if not log.exists():  # else another process was faster
                raise
        return log


def find_origin(path: Path) -> str | None:
    """URL, without credentials, of which a path is the copy; None where it is no copy."""
    try:
        return (path.parent / _ORIGIN).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None


def list_files(pattern: str) -> dict[str, str]:
    """URLs that a pattern with ``*``, ``?`` or ``[...]`` matches, or of all files below a folder; sorted.

    Each with what `describe_remote` returns of it, from the listing: that is one request for a thousand files. A ``?``
    in an http URL begins its query. Raises as `describe_remote`; there may be none.
    """
    with _translate(pattern):
        system, path = _connect(pattern)
        wild = "*" in path or "[" in path
        found: dict[str, dict[str, Any]] = system.glob(path, detail=True) if wild else system.find(path, detail=True)
        scheme = pattern.partition("://")[0]
        return {
            name if is_url(name) else f"{scheme}://{name}": _state({name: info})
            for name, info in sorted(found.items())
            if info["type"] != "directory"
        }


def _connect(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it."""
    try:
        import fsspec  # an extra, and slow to import
    except ImportError:
        raise MissingDependencyError(f"{url.partition('://')[0]}://", "fsspec", "remote") from None
    system, path = fsspec.core.url_to_fs(url, use_listings_cache=False)
    return system, path


def _find(system: Any, path: str, url: str) -> dict[str, dict[str, Any]]:  # noqa: ANN401
    """Description of each file of a log by its path: of one, or of all in a folder."""
    info = system.info(path)
    if info["type"] != "directory":
        return {path.rstrip("/"): info}
    found: dict[str, dict[str, Any]] = system.find(path, detail=True)
    if not found:
        raise InputError(mask_url(url), "no such file, and no files below it")
    return dict(sorted(found.items()))


def _state(files: dict[str, dict[str, Any]]) -> str:
    parts = [
        [name.rpartition("/")[2], info.get("size"), *(str(info[key]) for key in _STATE if info.get(key) is not None)]
        for name, info in files.items()
    ]
    return repr(parts)


def _find_cache() -> Path:
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "gridslam", "logs")
    return Path(os.environ.get(_CACHE) or default)


def _download(system: Any, path: str, files: dict[str, dict[str, Any]], target: Path, url: str) -> None:  # noqa: ANN401
    """Copy the files of a log: one, or those in the folder `path`."""
    for file, info in files.items():
        below = PurePosixPath(file).relative_to(path.rstrip("/"))
        if ".." in below.parts:
            raise InputError(mask_url(url), f"expected files below it, got {os.fspath(below)!r}")
        copy = target / below
        copy.parent.mkdir(parents=True, exist_ok=True)
        system.get_file(file, os.fspath(copy))
        expected, got = info.get("size"), copy.stat().st_size
        if expected not in (None, got):
            problem = f"expected {expected} bytes, got {got}: it was changed, or the connection cut"
            raise InputError(mask_url(url), problem)


@contextmanager
def _translate(url: str) -> Iterator[None]:
    """Convert any exception of the libraries to one line without secrets."""
    try:
        yield
    except GridslamError:
        raise
    except ImportError as error:  # fsspec names the library that these URLs need
        raise GridslamError(f"{mask_url(url)}: cannot be read: {_without_secrets(error, url)}") from None
    except Exception as error:
        problem = "no such file" if isinstance(error, FileNotFoundError) else _reason(error, url)
        raise InputError(mask_url(url), problem) from None


def _reason(error: BaseException, url: str) -> str:
    if isinstance(error, PermissionError):
        return "access denied"
    name = type(error).__name__
    text = _without_secrets(error, url)
    return f"{name}: {text}" if text else name


def _without_secrets(error: BaseException, url: str) -> str:
    """Return the message of an error, in which URLs and the secrets of this one are masked."""
    text = mask_urls(" ".join(str(error).split()))
    for secret in sorted(_secrets(url), key=len, reverse=True):
        text = text.replace(secret, _MASK)
    return text[:300]


def _secrets(url: str) -> set[str]:
    found: set[str] = set()
    with suppress(ValueError):  # no URL after all
        parts = urlsplit(url)
        found |= {parts.username or "", parts.password or "", parts.query}
        found |= {value for _, value in parse_qsl(parts.query)}
    for name in ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN"):
        found.add(os.environ.get(name, ""))
    found |= {unquote(secret) for secret in found}
    return {secret for secret in found if len(secret) > 2}
