"""Trees of parameters as nested tables, and changes to them with errors that name the parameter.

Works on the classes of `gridslam.parameters`. Fields of several classes are annotated with its `Kind`.
"""

from __future__ import annotations

import difflib
import functools
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, to_json

from gridslam.arguments import require_plain
from gridslam.errors import ConfigurationError, describe_failure
from gridslam.parameters import Table, to_table

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_Part = TypeVar("_Part")
_MOST_DOTS = 100  # a parser takes time and memory that grow with the square of the parts of a dotted key
_UNKNOWN = "unexpected_keyword_argument", "extra_forbidden"  # pydantic's types of errors
_BOOLEANS = {"True": True, "False": False}
_DECIMAL = re.compile(r"[-+]?(\d+\.\d*|\.\d+)([eE][-+]?\d+)?")  # TOML wants digits on both sides of the point


def value_of(part: object, name: str) -> object:
    """Return value of the parameter of that dotted name; of a part that may be None, whether it is there."""
    value = functools.reduce(getattr, name.split("."), part)
    return value is not None if value is None or is_dataclass(value) else value


def names(part: object) -> Iterator[str]:
    """Dotted names of all parameters of a part."""
    return _names(to_table(part))


def nest(values: Mapping[str, Any]) -> Table:
    """Return nested tables of values by dotted names.

    Raises ConfigurationError where a name is given a value and is a table, too.
    """
    tree: Table = {}
    for name, value in values.items():
        *above, last = name.split(".")
        table = tree
        for key in above:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise ConfigurationError(f"{name}: {key} was given as {table!r} before")
        table[last] = value
    return tree


def read_assignments(assignments: Iterable[str]) -> Table:
    """Values by name of texts ``name=value``; a value is one of TOML, a number like ``0.``, or a text without quotes.

    Raises ConfigurationError for a text of another form.
    """
    values: Table = {}
    for assignment in assignments:
        name, equals, text = (part.strip() for part in assignment.partition("="))
        if not (name and equals and text) or name.count(".") > _MOST_DOTS:
            raise ConfigurationError(f"expected name=value, got {assignment!r:.200}")
        values.pop(name, None)  # the last one counts, by whatever name
        try:
            values[name] = _read_value(text)
        except ConfigurationError as error:
            raise ConfigurationError(f"{name}: {error}") from None
    return values


def parse_toml(text: str) -> Table:
    """Read TOML; raises ConfigurationError for any text that is not valid TOML."""
    try:
        return _parse(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"expected TOML: {error}") from None


def _parse(text: str) -> Table:
    """Read TOML; raises TOMLDecodeError, and ConfigurationError for TOML that no configuration can hold."""
    if any(line.count(".") > _MOST_DOTS for line in text.split("\n")):
        raise ConfigurationError(f"expected TOML with at most {_MOST_DOTS} dots in a line, got more")
    try:
        table = tomllib.loads(text)
        require_plain(table)
    except tomllib.TOMLDecodeError:
        raise
    except Exception as error:
        raise ConfigurationError(f"expected TOML: {describe_failure(error)}") from None
    return table


def _read_value(text: str) -> Any:  # noqa: ANN401
    """Return value of TOML, a number as YAML and Python write it (``0.``, ``.5``, ``True``), or the text itself."""
    try:
        return _parse(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    return float(text) if _DECIMAL.fullmatch(text) else text


def replace_parameters(
    part: _Part, changes: Mapping[str, Any], also: Iterable[str] = (), *, ignore_unknown: bool = False
) -> _Part:
    """Return the part with other parameters, checked.

    Parameters
    ----------
    part : object of a class of parameters
        Values of parameters that `changes` do not contain. A change of kind starts from that kind's defaults.
    changes : mapping
        Nested as `to_table` gives it.
    also : iterable of str
        Further names that a message may suggest.
    ignore_unknown : bool
        Whether parameters that there are no longer are left out.

    Raises
    ------
    ConfigurationError
        A parameter is unknown, of a wrong type or out of range.
    """
    table = _merge(to_table(part), changes)
    try:
        # as JSON, which strictly has tables for parts, but no number for a text; infinities are no numbers there
        text = to_json(table, inf_nan_mode="null", fallback=repr)
        changed: _Part = TypeAdapter(type(part)).validate_json(text, strict=True)
    except ValidationError as error:
        unknown = [each["loc"] for each in error.errors() if each["type"] in _UNKNOWN]
        if ignore_unknown and unknown:
            return replace_parameters(part, functools.reduce(_without, unknown, changes), also, ignore_unknown=True)
        raise ConfigurationError(describe_error(error.errors()[0], table, [*also, *names(part)])) from None
    return changed


def describe_error(error: ErrorDetails, table: Mapping[str, Any], known: Iterable[str] = ()) -> str:
    """Describe in one line the parameter of a table, the expected and the actual value, with similar names."""
    path = list[str]()
    value: Any = table
    for key in error["loc"]:
        if isinstance(value, Mapping) and key in value:  # others are names of kinds
            path.append(str(key))
            value = value[key]
    name = ".".join(path)
    match error["type"]:
        case "union_tag_invalid":
            context = error.get("ctx", {})
            tag = context["tag"]
            kinds = context["expected_tags"].replace("'", "")
            return f"{name}.kind: expected one of {kinds}, got {tag!r}{suggest_names(tag, kinds.split(', '))}"
        case "union_tag_not_found" | "dataclass_type":
            return f"{name}: expected a table of parameters, got {value!r}"
        case kind if kind in _UNKNOWN:
            return f"{name}: no such parameter{suggest_names(name, known)}"
        case "value_error":
            return f"{name or 'configuration'}: {error['msg'].removeprefix('Value error, ')}"
    expected = re.sub("^Input should be (?=greater|less)", "a number ", error["msg"])
    return f"{name}: expected {expected.removeprefix('Input should be ')}, got {value!r}"


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Return a question with the known names that look like this one; empty where none does."""
    candidates = list(dict.fromkeys(known))
    last = name.rpartition(".")[2]
    close = [candidate for candidate in candidates if candidate.rpartition(".")[2] == last]
    close += [candidate for candidate in difflib.get_close_matches(name, candidates) if candidate not in close]
    return f"; did you mean {' or '.join(close[:3])}?" if close else ""


def _names(table: Table) -> Iterator[str]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from (f"{name}.{below}" for below in _names(value))
        else:
            yield name


def _without(table: Mapping[str, Any], path: Sequence[Any]) -> Mapping[str, Any]:
    """Return a table without the parameter at a path; the path includes the names of kinds."""
    key, *below = path
    if key not in table:
        return _without(table, below)
    if not below:
        return {name: value for name, value in table.items() if name != key}
    return {**table, key: _without(table[key], below)}


def _merge(table: Any, changes: Any) -> Any:  # noqa: ANN401
    """Merge changes into a table; a value of another kind, or a value that is no table, replaces the old one."""
    if not isinstance(table, dict):
        return changes
    kind = table.get("kind")
    if changes is True and kind not in (None, "none"):  # it is there
        return table
    if not isinstance(changes, Mapping) or changes.get("kind", kind) != kind:
        return changes
    return table | {name: _merge(table.get(name), change) for name, change in changes.items()}
