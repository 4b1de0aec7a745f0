"""Classes of parameters: frozen dataclasses whose values are checked when one is made.

A value of the declared type and within its bounds is taken after a look. All else is left to pydantic, which converts
it or reports what is wrong, and is imported only then: it takes nearly as long as NumPy, and 15 MB.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, FrozenInstanceError, dataclass, field, fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast, final, get_args, get_origin
from typing import get_type_hints as evaluate_hints

if TYPE_CHECKING:
    import inspect

    from pydantic import GetCoreSchemaHandler, TypeAdapter
    from pydantic_core import CoreSchema

__all__ = ["Kind", "Table", "adapter", "bounded", "parameters", "replace_plainly", "to_table"]

Table = dict[str, Any]
_Part = TypeVar("_Part")
_Number = TypeVar("_Number", int, float)
_BOUNDS: Mapping[str, Callable[[Any, Any], bool]] = {
    "ge": operator.ge,
    "gt": operator.gt,
    "le": operator.le,
    "lt": operator.lt,
}


if TYPE_CHECKING:
    from dataclasses import dataclass as parameters
else:

    def parameters(*, frozen: Literal[True]) -> Callable[[type], type]:
        """As `dataclasses.dataclass`, for a class whose values are checked, NaN and infinities being refused.

        Making an object raises pydantic.ValidationError for a value of a wrong type or out of its bounds, and where
        ``__post_init__`` raises a ValueError.
        """

        def decorate(part: type) -> type:
            dataclass(init=False, repr=False, eq=False)(part)
            for name in ("__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__signature__"):
                setattr(part, name, vars(_Methods)[name])
            part.__pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}
            return part

        return decorate


class _Signature:
    """The signature of a class of parameters, made when somebody asks for it."""

    def __get__(self, instance: object, part: Any) -> inspect.Signature:  # noqa: ANN401
        if instance is not None:
            raise AttributeError("__signature__")  # it is that of the class
        from inspect import Parameter, Signature

        def describe(each: Field[Any]) -> Parameter:
            default = Parameter.empty if each.default is MISSING else each.default
            if each.default_factory is not MISSING:
                default = each.default_factory()
            return Parameter(each.name, Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=each.type)

        return Signature([describe(each) for each in fields(part)], return_annotation=None)


class _Methods:
    """What `dataclass` would compile for each class by itself, which takes a tenth of the time to the first scan."""

    __signature__ = _Signature()

    def __init__(self, *args: object, **kwargs: object) -> None:
        kind: Any = type(self)
        try:
            if not (args or kwargs) or _fit(kind, args, kwargs):
                _assign(self, args, kwargs)
                return
        except (TypeError, ValueError):
            pass  # pydantic names the parameter
        from pydantic_core import ArgsKwargs

        adapter(kind).validator.validate_python(ArgsKwargs(args, kwargs), self_instance=self)

    def __repr__(self) -> str:
        kind: Any = type(self)
        values = zip(_names(kind), _values(self), strict=True)
        return f"{type(self).__qualname__}({', '.join(f'{name}={value!r}' for name, value in values)})"

    def __eq__(self, other: object) -> bool:
        return _values(self) == _values(other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(_values(self))

    def __setattr__(self, name: str, value: object) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> None:
        raise FrozenInstanceError(f"cannot delete field {name!r}")


def _assign(made: Any, args: tuple[object, ...], kwargs: Mapping[str, object]) -> None:  # noqa: ANN401
    """Set all fields of an object; raises TypeError where an argument is given twice, or lacking.

    The names of `kwargs` are those of fields, as `_fit` has found.
    """
    given = dict(zip([each.name for each in fields(made)], args, strict=False))
    if len(given) < len(args) or given.keys() & kwargs.keys():
        raise TypeError("too many arguments, or one given twice")
    given.update(kwargs)
    values = vars(made)
    for each in fields(made):
        if each.name in given:
            values[each.name] = given[each.name]
        elif each.default is not MISSING:
            values[each.name] = each.default
        elif each.default_factory is not MISSING:
            values[each.name] = each.default_factory()
        else:
            raise TypeError(f"{each.name} is missing")
    if hasattr(made, "__post_init__"):
        made.__post_init__()


@functools.cache
def _names(part: Callable[..., object]) -> tuple[str, ...]:
    return tuple(each.name for each in fields(cast("Any", part)))


def _values(made: object) -> tuple[object, ...]:
    kind: Any = type(made)
    values = vars(made)
    return tuple([values[name] for name in _names(kind)])


def bounded(default: _Number, **bounds: float) -> _Number:
    """Field of a number: its default, and its bounds `ge`, `gt`, `le` and `lt`."""
    return field(default=default, metadata=bounds)


def adapter(part: type[_Part]) -> TypeAdapter[_Part]:
    """What pydantic checks objects of a class of parameters with."""
    kind: Any = part
    return cast("TypeAdapter[_Part]", _adapter(kind))


@functools.cache
def _adapter(part: type) -> object:
    from pydantic import TypeAdapter

    return TypeAdapter(part)


def to_table(part: Any) -> Table:  # noqa: ANN401
    """Parameters of a part; those of its own parts are tables in it."""
    kind: Any = type(part)
    return {name: rule.write(getattr(part, name)) for name, rule in _rules(kind).items()}


def replace_plainly(part: _Part, changes: object) -> _Part | None:
    """Part with other parameters, nested as `to_table` gives them; None where pydantic has to convert or refuse one."""
    if not isinstance(changes, Mapping):
        return None
    kind: Any = type(part)
    values = {}
    for name, change in changes.items():
        rule = _rules(kind).get(name)
        if rule is None:
            return None
        below = getattr(part, name)
        if isinstance(change, Mapping) and is_dataclass(below) and "kind" not in change:
            change = replace_plainly(below, change)
            if change is None:
                return None
        elif not rule.accepts(change):
            return None
        values[name] = change
    try:
        replaced: _Part = replace(cast("Any", part), **values)
    except ValueError:  # by a check of several parameters together
        return None
    return replaced


class _Rule(NamedTuple):
    """What values of a field need no conversion: of these types, or one of these, within bounds."""

    types: frozenset[object]
    choices: tuple[object, ...]
    bounds: Mapping[str, float]
    has_kind: bool

    def accepts(self, value: object) -> bool:
        if type(value) is str and value in self.choices:
            return True
        if type(value) is float and not math.isfinite(value):
            return False
        if type(value) not in self.types:
            return False
        return all(_BOUNDS[name](value, limit) for name, limit in self.bounds.items() if name in _BOUNDS)

    def write(self, value: object) -> object:
        written = to_table(value) if is_dataclass(value) else value
        if not self.has_kind:
            return written
        return {"kind": _name(type(value)), **(written if isinstance(written, dict) else {})}


@functools.cache
def _rules(part: Callable[..., object]) -> dict[str, _Rule]:
    """Rules of a class of parameters by the names of its fields."""
    hints = evaluate_hints(part, include_extras=True)
    return {each.name: _rule(hints[each.name], each.metadata) for each in fields(cast("Any", part))}


def _rule(hint: object, bounds: Mapping[str, float]) -> _Rule:
    notes = getattr(hint, "__metadata__", ())
    has_kind = any(isinstance(note, Kind) for note in notes)
    inner = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if len(notes) > has_kind:  # more to check
        return _Rule(frozenset(), (), bounds, has_kind)
    if get_origin(inner) is Literal:
        return _Rule(frozenset(), get_args(inner), bounds, has_kind)
    types = get_args(inner) if get_origin(inner) in (Union, UnionType) else (inner,)
    return _Rule(frozenset(types), (), bounds, has_kind)


def _fit(part: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> bool:
    """Whether all values need no conversion. How many there are, and what their names are, is not looked at."""
    rules = _rules(part)
    given = [*zip(rules, args, strict=False), *kwargs.items()]
    return all(name in rules and rules[name].accepts(value) for name, value in given)


@final
class Kind:
    """Annotation of a field whose part may be of several classes, or None: ``Annotated[A | B | None, Kind()]``.

    In a table of parameters the key ``kind`` is the name of the class; None is the kind "none". Where None is possible,
    `false` is short for it, and `true` for the first class with its defaults.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401
        """Tagged union of the classes."""
        from pydantic_core import core_schema

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

        choices: dict[Any, CoreSchema] = {
            name: core_schema.no_info_before_validator_function(
                _drop_kind, nothing if part is NoneType else handler.generate_schema(part)
            )
            for name, part in classes.items()
        }
        return core_schema.tagged_union_schema(choices, find_kind)


def _name(part: type) -> str:
    return "none" if part is NoneType else part.__name__


def _drop_kind(value: object) -> object:
    if isinstance(value, Mapping):
        return {name: parameter for name, parameter in value.items() if name != "kind"}
    return {} if value is None or isinstance(value, bool) else value
