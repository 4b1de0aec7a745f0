"""Classes of parameters: pydantic's frozen dataclasses, whose values are checked when one is made."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from inspect import Signature, signature
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, final, get_args

from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from gridslam.errors import ConfigurationError

__all__ = ["Kind", "Table", "bounded", "parameters", "to_table"]

Table = dict[str, Any]
_Number = TypeVar("_Number", int, float)

if TYPE_CHECKING:
    from dataclasses import dataclass as parameters
else:

    def parameters(*, frozen: Literal[True]) -> Callable[[type], type]:
        """As `dataclasses.dataclass`, for a class whose values are checked, NaN and infinities being refused.

        Making an object raises ConfigurationError for a value of a wrong type or out of its bounds, and where
        ``__post_init__`` raises a ValueError.
        """
        config = ConfigDict(extra="forbid", allow_inf_nan=False)

        def decorate(part: type) -> type:
            made = dataclass(frozen=frozen, config=config)(part)
            fields = [each for each in signature(made).parameters.values() if each.kind is not each.VAR_POSITIONAL]
            # as it is: pydantic states fields as keywords alone
            made.__signature__ = Signature([each.replace(kind=each.POSITIONAL_OR_KEYWORD) for each in fields])
            validate = made.__init__

            @functools.wraps(validate)
            def __init__(self: object, *args: object, **values: object) -> None:  # noqa: N807
                try:
                    validate(self, *args, **values)
                except ValidationError as error:
                    names = [each.name for each in fields]
                    raise ConfigurationError(f"{made.__name__}: {_describe(error.errors()[0], names)}") from None

            made.__init__ = __init__
            return made

        return decorate


def _describe(error: ErrorDetails, names: Sequence[str]) -> str:
    """Describe in one line the first wrong parameter of a call, the expected and the actual value."""
    at = [names[key] if isinstance(key, int) and key < len(names) else str(key) for key in error["loc"][:1]]
    name = ".".join([*at, *map(str, error["loc"][1:])])
    if error["type"] == "unexpected_keyword_argument":
        return f"{name}: no such parameter"
    if error["type"] == "unexpected_positional_argument":
        return f"unexpected positional argument, {error['input']!r}"
    if error["type"].startswith("union_tag"):
        return f"{name}: expected an object of one of its kinds, got {error['input']!r}"
    if error["type"] == "value_error":
        problem = error["msg"].removeprefix("Value error, ")
        return f"{name}: {problem}" if name else problem
    expected = re.sub("^Input should be (?=greater|less)", "a number ", error["msg"]).removeprefix("Input should be ")
    return f"{name}: expected {expected}, got {error['input']!r}"


def bounded(default: _Number, **bounds: float) -> _Number:
    """Field of a number: its default, and its bounds `ge`, `gt`, `le` and `lt`."""
    return field(default=default, metadata=bounds)


def to_table(part: object) -> Table:
    """Return parameters of a part; those of its own parts are tables in it."""
    table: Table = TypeAdapter(type(part)).dump_python(part)
    return table


@final
class Kind:
    """Annotation of a field whose part may be of several classes, or None: ``Annotated[A | B | None, Kind()]``.

    In a table of parameters the key ``kind`` is the name of the class; None is the kind "none". Where None is possible,
    `false` is short for it, and `true` for the first class with its defaults.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401
        """Tagged union of the classes."""
        classes = {_name(part): part for part in get_args(source)}
        # None as a table without parameters
        nothing = core_schema.no_info_after_validator_function(
            lambda _: None, core_schema.typed_dict_schema({}, extra_behavior="forbid")
        )

        def find_kind(value: object) -> object:
            if isinstance(value, Mapping):
                return value.get("kind")
            if isinstance(value, bool) and "none" in classes:
                return next(iter(classes)) if value else "none"
            name = _name(type(value))
            return name if name in classes else None

        def write(value: object, write_table: Callable[[object], Table]) -> Table:
            return {"kind": _name(type(value)), **({} if value is None else write_table(value))}

        choices: dict[Any, CoreSchema] = {
            name: core_schema.no_info_before_validator_function(
                _drop_kind, nothing if part is NoneType else handler.generate_schema(part)
            )
            for name, part in classes.items()
        }
        serialization = core_schema.wrap_serializer_function_ser_schema(write)
        return core_schema.tagged_union_schema(choices, find_kind, serialization=serialization)


def _name(part: type) -> str:
    return "none" if part is NoneType else part.__name__


def _drop_kind(value: object) -> object:
    if isinstance(value, Mapping):
        return {name: parameter for name, parameter in value.items() if name != "kind"}
    return {} if value is None or isinstance(value, bool) else value
