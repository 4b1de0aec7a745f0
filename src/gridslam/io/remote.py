"""Logs at URLs, read through a cache on this machine; by fsspec, an extra.

Credentials in a URL, its user and its query, appear in no message and in no file (`mask_url`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import parse_qsl, unquote, urlsplit

from gridslam.errors import GridslamError, InputError, MissingDependencyError
from gridslam.io.cache import Cached, LogCache

__all__ = [
    "describe_remote",
    "fetch",
    "is_url",
    "list_files",
    "mask_url",
    "mask_urls",
]

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_STATE = ("ETag", "etag", "LastModified", "mtime", "md5Hash", "crc32c", "generation", "VersionId", "content_md5")
"""Properties of a file's content, besides its size, that file systems may report."""
_MASK: Final = "***"


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
    """Return a text in which URLs are without their credentials."""
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


def fetch(url: str, cache: LogCache | None = None) -> Cached:
    """Copy a log at a URL, a file or the folder of a ROS 2 bag, into the cache, unless it is there already.

    Parameters
    ----------
    url : str
        Where it is; credentials are those of the environment, as the libraries of fsspec expect them.
    cache : LogCache, optional
        By default that of `LogCache.default`.

    Returns
    -------
    Cached
        The copy: its path and its SHA-256. It stays in the cache as long as this process lives.

    Raises
    ------
    MissingDependencyError, InputError
        As `describe_remote`; InputError also where the copy is not complete, or larger than the cache.
    OutputError
        The cache cannot be written.
    """
    cache = cache or LogCache.default()
    with _translate(url):
        system, path = _connect(url)
        files = _find(system, path, url)
        size = sum(int(info.get("size") or 0) for info in files.values())
        cache.require_size(size, mask_url(url))
        root = path.rstrip("/")
        name = PurePosixPath(root.partition("?")[0]).name or "log"

        def download(folder: Path) -> Path:
            target = folder / name
            if list(files) == [root] or list(files) == [path]:
                _download(system, path, target, files[next(iter(files))], url)
                return target
            for file, info in files.items():
                relative = PurePosixPath(file).relative_to(root)
                (target / relative).parent.mkdir(parents=True, exist_ok=True)
                _download(system, file, target / relative, info, url)
            return target

        return cache.get(mask_url(url), _state(files), download)


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


def _download(system: Any, path: str, target: Path, info: dict[str, Any], url: str) -> None:  # noqa: ANN401
    system.get_file(path, os.fspath(target))
    expected, got = info.get("size"), target.stat().st_size
    if expected is not None and got != expected:
        raise InputError(mask_url(url), f"expected {expected} bytes, got {got}: it was changed, or the connection cut")


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
