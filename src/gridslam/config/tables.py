"""Trees of parameters as nested tables, and changes to them with errors that name the parameter.

Works on any pydantic dataclass. Where a field allows several classes its table has the key ``kind``, the class's name;
None, where the field allows that, is the kind "none".
"""

from __future__ import annotations

import difflib
import functools
import math
import types
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from gridslam.errors import ConfigurationError

__all__ = ["Table", "names", "replace_parameters", "suggest_names", "to_table", "value_of"]

Table = dict[str, Any]
_Part = TypeVar("_Part")

_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_NOUNS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def to_table(part: object) -> Table:
    """Parameters of a part; those of its own parts are tables in it."""
    table: Table = {}
    for name, field in _fields(type(part)).items():
        value, kinds = getattr(part, name), _kinds(field)
        kind = {"kind": _name(type(value))} if len(kinds) > 1 else {}
        table[name] = kind | to_table(value) if kinds else value
    return table


def value_of(part: object, name: str) -> object:
    """Value of the parameter of that dotted name."""
    return functools.reduce(getattr, name.split("."), part)


def names(part: object, where: str = "") -> Iterator[str]:
    """Dotted names of all parameters of a part."""
    for name, field in _fields(type(part)).items():
        kinds = _kinds(field)
        if len(kinds) > 1:
            yield f"{where}{name}.kind"
        if kinds:
            yield from names(getattr(part, name), f"{where}{name}.")
        else:
            yield where + name


def replace_parameters(part: _Part, changes: Mapping[str, Any], where: str = "") -> _Part:
    """Return the part with other parameters, checked.

    Parameters
    ----------
    part : pydantic dataclass
        Values of parameters that `changes` do not contain. A change of kind starts from that kind's defaults.
    changes : mapping
        Nested as `to_table` gives it.
    where : str
        Dotted name of the part itself, with a dot at its end; empty for the root.

    Raises
    ------
    ConfigurationError
        A parameter is unknown, of a wrong type or out of range.
    """
    fields = _fields(type(part))
    values = {name: getattr(part, name) for name in fields}
    for name, value in changes.items():
        if name not in fields:
            close = suggest_names(name, names(part, where), where)
            raise ConfigurationError(f"{where}{name}: {_name(type(part))} has no such parameter{close}")
        field = fields[name]
        if _kinds(field):
            value = _changed_part(field, values[name], value, where + name)
        else:
            _check_type(field, value, where + name)
        values[name] = value
    try:
        return type(part)(**values)
    except ValidationError as error:
        raise _refused(error, fields, where) from None


def suggest_names(name: str, known: Iterable[str], where: str = "") -> str:
    """Ask after names that look like this one; empty where none does."""
    candidates = list(known)
    close = [known for known in candidates if known.rpartition(".")[2] == name]
    close += [known for known in difflib.get_close_matches(where + name, candidates) if known not in close]
    return f"; did you mean {' or '.join(close[:3])}?" if close else ""


def _fields(cls: type) -> dict[str, FieldInfo]:
    fields: dict[str, FieldInfo] = getattr(cls, "__pydantic_fields__", {})  # None has none
    return fields


def _kinds(field: FieldInfo) -> tuple[type, ...]:
    """Classes that a field's part may be of, that of None among them; none for a plain value."""
    union = get_origin(field.annotation) in (Union, types.UnionType)
    options = get_args(field.annotation) if union else (field.annotation,)
    kinds = tuple(option for option in options if isinstance(option, type) and is_dataclass(option))
    return (*kinds, types.NoneType) if kinds and types.NoneType in options else kinds


def _name(kind: type) -> str:
    return "none" if kind is types.NoneType else kind.__name__


def _changed_part(field: FieldInfo, part: object, changes: object, where: str) -> object:
    if not isinstance(changes, Mapping):
        raise ConfigurationError(f"{where}: expected a table of parameters, got {changes!r}")
    kinds = {_name(kind): kind for kind in _kinds(field)}
    if len(kinds) > 1 and "kind" in changes:
        kind = changes["kind"]
        if kind not in kinds:
            raise ConfigurationError(
                f"{where}.kind: expected {_either(kinds)}, got {kind!r}{suggest_names(str(kind), kinds)}"
            )
        part = part if type(part) is kinds[kind] else kinds[kind]()
        changes = {name: value for name, value in changes.items() if name != "kind"}
    return replace_parameters(part, changes, where + ".")


def _check_type(field: FieldInfo, value: object, where: str) -> None:
    """Refuse what pydantic would convert: it checks ranges, but takes "1", 1.0 and true for 1, and infinity."""
    wanted = field.annotation
    if wanted is float:
        fits = isinstance(value, int | float) and math.isfinite(value)
    else:
        fits = wanted not in _NOUNS or isinstance(value, wanted)
    if not fits or (isinstance(value, bool) and wanted is not bool):
        raise ConfigurationError(f"{where}: expected {_range(field)}, got {value!r}")


def _range(field: FieldInfo) -> str:
    """What a plain field takes, in words."""
    if field.annotation not in _NOUNS:
        return _either(str(choice) for choice in get_args(field.annotation))
    bounds = [
        f"{sign} {getattr(item, name):g}"
        for item in field.metadata
        for name, sign in _BOUNDS.items()
        if hasattr(item, name)
    ]
    return f"{_NOUNS[field.annotation]} {' and '.join(bounds)}".strip()


def _either(choices: Iterable[str]) -> str:
    *others, last = choices
    return f"{', '.join(others)} or {last}" if others else last


def _refused(error: ValidationError, fields: Mapping[str, FieldInfo], where: str) -> ConfigurationError:
    first = error.errors()[0]
    name = str(first["loc"][0]) if first["loc"] else ""
    if name not in fields:
        problem = first["msg"].removeprefix("Value error, ")
        return ConfigurationError(f"{where.rstrip('.') or 'configuration'}: {problem}")
    return ConfigurationError(f"{where}{name}: expected {_range(fields[name])}, got {first['input']!r}")
