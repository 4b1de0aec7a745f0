"""How the parameters of all parts are checked, and how a table chooses the class of a part."""

from __future__ import annotations

from collections.abc import Mapping
from types import NoneType
from typing import Any, final, get_args

from pydantic import ConfigDict, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

__all__ = ["STRICT", "Kind"]

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


@final
class Kind:
    """Annotation of a field whose part may be of several classes, or None: ``Annotated[A | B | None, Kind()]``.

    In a table of parameters the key ``kind`` is the name of the class; None is the kind "none". Where None is possible,
    `false` is short for it, and `true` for the first class with its defaults.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401
        """Tagged union of the classes."""
        classes = {_name(part): part for part in get_args(source)}

        def find_kind(value: object) -> object:
            if isinstance(value, Mapping):
                return value.get("kind")
            if isinstance(value, bool) and "none" in classes:
                return next(iter(classes)) if value else "none"
            name = _name(type(value))
            return name if name in classes else None

        choices: dict[Any, CoreSchema] = {
            name: core_schema.no_info_before_validator_function(
                _drop_kind, _NONE if part is NoneType else handler.generate_schema(part)
            )
            for name, part in classes.items()
        }
        return core_schema.tagged_union_schema(
            choices, find_kind, serialization=core_schema.wrap_serializer_function_ser_schema(_add_kind)
        )


_NONE = core_schema.no_info_after_validator_function(
    lambda nothing: None, core_schema.typed_dict_schema({}, extra_behavior="forbid")
)
"""None as a table without parameters."""


def _name(part: type) -> str:
    return "none" if part is NoneType else part.__name__


def _drop_kind(value: object) -> object:
    if isinstance(value, Mapping):
        return {name: parameter for name, parameter in value.items() if name != "kind"}
    return {} if value is None or isinstance(value, bool) else value


def _add_kind(value: object, serialize: core_schema.SerializerFunctionWrapHandler) -> dict[str, Any]:
    return {"kind": _name(type(value)), **({} if value is None else serialize(value))}
