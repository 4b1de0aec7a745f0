"""Classes of parameters: pydantic's frozen dataclasses, whose values are checked when one is made."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import field
from inspect import Signature, signature
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, final, get_args

from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter
from pydantic.dataclasses import dataclass
from pydantic_core import CoreSchema, core_schema

__all__ = ["Kind", "Table", "adapter", "bounded", "parameters", "to_table"]

Table = dict[str, Any]
_Part = TypeVar("_Part")
_Number = TypeVar("_Number", int, float)

if TYPE_CHECKING:
    from dataclasses import dataclass as parameters
else:

    def parameters(*, frozen: Literal[True]) -> Callable[[type], type]:
        """As `dataclasses.dataclass`, for a class whose values are checked, NaN and infinities being refused.

        Making an object raises pydantic.ValidationError for a value of a wrong type or out of its bounds, and where
        ``__post_init__`` raises a ValueError.
        """
        config = ConfigDict(extra="forbid", allow_inf_nan=False)

        def decorate(part: type) -> type:
            made = dataclass(frozen=frozen, config=config)(part)
            fields = [each for each in signature(made).parameters.values() if each.kind is not each.VAR_POSITIONAL]
            # as it is: pydantic states fields as keywords alone
            made.__signature__ = Signature([each.replace(kind=each.POSITIONAL_OR_KEYWORD) for each in fields])
            return made

        return decorate


def bounded(default: _Number, **bounds: float) -> _Number:
    """Field of a number: its default, and its bounds `ge`, `gt`, `le` and `lt`."""
    return field(default=default, metadata=bounds)


def adapter(part: type[_Part]) -> TypeAdapter[_Part]:
    """Return the adapter by which pydantic checks objects of a class of parameters."""
    kind: Any = part
    return cast("TypeAdapter[_Part]", _adapter(kind))


@functools.cache
def _adapter(part: type) -> TypeAdapter[Any]:
    return TypeAdapter(part)


def to_table(part: object) -> Table:
    """Return parameters of a part; those of its own parts are tables in it."""
    table: Table = adapter(type(part)).dump_python(part)
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
