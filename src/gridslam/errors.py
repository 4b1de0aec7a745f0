"""The exception tree of gridslam. Every error a caller can make or meet derives from `GridslamError`."""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "ArgumentError",
    "ConfigurationError",
    "ConsumedStateError",
    "GridslamError",
    "InputError",
    "MissingDependencyError",
    "OutputError",
]


class GridslamError(Exception):
    """Base of all errors raised by gridslam."""

    def __reduce__(self) -> tuple[object, ...]:
        """Return how pickle rebuilds the error: from message and attributes, as `__init__` takes other arguments."""
        return type(self).__new__, (type(self), *self.args), self.__dict__


class ArgumentError(GridslamError, ValueError):
    """Raised for an invalid argument; has its name, the expected and the actual value."""

    def __init__(self, argument: str, expected: str, got: object) -> None:
        super().__init__(f"{argument}: expected {expected}, got {' '.join(str(got).split())}")
        self.argument = argument
        self.expected = expected
        self.got = got


class ConfigurationError(GridslamError, ValueError):
    """A preset, parameter or configuration file is unknown, malformed or out of range; the message is one line."""

    def __init__(self, problem: str) -> None:
        super().__init__(" ".join(problem.splitlines()))


class ConsumedStateError(GridslamError, RuntimeError):
    """A filter state was used after `step` consumed it."""

    def __init__(self) -> None:
        super().__init__("this state was consumed by an earlier step; keep one for later with state.snapshot()")


class InputError(GridslamError):
    """Raised for an unusable file; has its name, the line if there is one, the expected and the actual content."""

    def __init__(self, path: str | Path, problem: str, line: int | None = None) -> None:
        where = f"{path}" if line is None else f"{path}, line {line}"
        super().__init__(f"{where}: {' '.join(problem.splitlines())}")
        self.path = Path(path)
        self.line = line


class MissingDependencyError(GridslamError, ImportError):
    """Something needs a library that is not installed: names the extra which brings it."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        super().__init__(f"{what} needs {library}, which is not installed: pip install 'gridslam[{extra}]'")


class OutputError(GridslamError):
    """A result cannot be written."""


def describe_failure(error: Exception) -> str:
    """Describe an exception of a parser of any type in a few words, on one line."""
    if isinstance(error, RecursionError):
        return "values nested too deeply"
    if isinstance(error, MemoryError):
        return "more than fits into memory"
    return " ".join(str(error).split())[:200] or type(error).__name__
