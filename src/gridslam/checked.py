"""Checks of the arguments of public functions by their annotations, once: where a caller enters the package.

What is called from within such a function is not checked again. `Annotated` states shapes and limits, as in saved
states (`gridslam.serialization`): `Annotated[FloatArray, "K", 3]` has three columns and as many rows as whatever else
is annotated with K. Arrays and numbers that do not fit are refused before the call, as kernels trust them. Types are
compared only after a call has failed, to name the argument: whatever works in the place of a type is welcome.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextvars import ContextVar
from types import FunctionType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    cast,
    final,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import Limits, describe
from gridslam.errors import ArgumentError, GridslamError

_Public = TypeVar("_Public", bound=Callable[..., Any])
_LARGEST = 1 << 62
_READ_LOGS = ("gridslam.api.", "gridslam.pipeline")
"""Modules that map whole logs: values that contradict each other there are no fault of an argument."""
_KINDS = {"f": "fiu", "i": "iu", "u": "iu", "b": "b"}
"""Dtype kinds that convert without loss to the annotated kind."""
_NUMBERS: Mapping[object, tuple[type, ...]] = {
    int: (int, np.integer),
    float: (int, float, np.integer, np.floating),
    bool: (bool, np.bool_),
}

_MEASURED = (int, float, np.number, np.ndarray)
_BUILTINS = {kind.__name__: kind for kind in (bool, bytes, dict, float, int, list, object, set, str, tuple, type)}
_is_within: ContextVar[bool] = ContextVar("is_within", default=False)
"""Whether a public function is under way, of which the arguments are checked; each thread has its own."""


class _Numbers:
    """Stands for `ArrayLike`: any value that converts to an array of numbers."""


class _Names(dict[str, Any]):
    """Names of a module, and Any for those that it imports for type checkers alone."""

    def __missing__(self, name: str) -> object:
        return _BUILTINS.get(name, Any)


def checked(public: _Public) -> _Public:
    """Check the arguments of a function, or of all public methods of a class and where one is made.

    Raises
    ------
    ArgumentError
        From the function: an argument is not what its annotation states, or its numbers are of no use.
    """
    if not isinstance(public, type):
        return cast("_Public", _check_calls(public))
    for name, member in list(vars(public).items()):
        if name.startswith("_") and name not in ("__init__", "__call__"):
            continue
        if isinstance(member, FunctionType) and member.__annotations__:
            setattr(public, name, _check_calls(member))
        elif isinstance(member, classmethod | staticmethod):
            setattr(public, name, type(member)(_check_calls(member.__func__)))
    return cast("_Public", public)


def _check_calls(function: Callable[..., Any]) -> Callable[..., Any]:
    reads_logs = function.__module__.startswith(_READ_LOGS)
    begins_later = inspect.isgeneratorfunction(function)  # its call never fails

    @functools.wraps(function)
    def check(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 whatever the function takes
        if _is_within.get():
            return function(*args, **kwargs)
        (_require_arguments if begins_later else _require_noted)(function, args, kwargs)
        before = _is_within.set(True)
        try:
            return function(*args, **kwargs)
        except GridslamError:
            raise
        except (TypeError, AttributeError, ValueError, LookupError, ArithmeticError) as error:
            if type(error).__module__.startswith("pydantic"):
                raise
            try:
                _require_arguments(function, args, kwargs)
            except ArgumentError as wrong:
                raise wrong from error
            if reads_logs or isinstance(error, TypeError | AttributeError | KeyError):
                raise  # no argument's fault
            raise ArgumentError(function.__qualname__, "arguments that go together", error or type(error)) from error
        finally:
            _is_within.reset(before)

    return check


@final
class _Signature(NamedTuple):
    """Signature of a function, its annotations, which parameters' have notes, and if one is the length of `self`."""

    signature: inspect.Signature
    hints: dict[str, Any]
    noted: frozenset[str]
    measures_self: bool


@functools.cache
def _signature(function: Callable[..., Any]) -> _Signature:
    names = _Names(getattr(function, "__globals__", {}))
    hints = get_type_hints(function, localns=names, include_extras=True)
    noted = frozenset(name for name, hint in hints.items() if name != "return" and get_origin(hint) is Annotated)
    return _Signature(inspect.signature(function), hints, noted, "'self'" in repr(hints))


def _require_noted(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    """Raise ArgumentError where an array or a number does not match an annotation with notes."""
    signature, hints, noted, measures_self = _signature(function)
    if not noted:
        return
    sizes = {"self": len(args[0])} if measures_self and args else {}
    for name, value in (*zip(signature.parameters, args, strict=False), *kwargs.items()):
        is_measured = isinstance(value, _MEASURED) and not isinstance(value, bool)
        if name in noted and is_measured and value is not signature.parameters[name].default:
            _require(name, value, hints[name], sizes)


def _require_arguments(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    """Raise ArgumentError where an argument does not match its annotation, TypeError where there is none such."""
    signature, hints, _, measures_self = _signature(function)
    arguments = signature.bind(*args, **kwargs).arguments
    sizes = {"self": len(arguments["self"])} if measures_self else {}
    for name, value in arguments.items():
        kind = signature.parameters[name].kind
        values = (
            value
            if kind is inspect.Parameter.VAR_POSITIONAL
            else value.values()
            if kind is inspect.Parameter.VAR_KEYWORD
            else (value,)
        )
        for each in values:
            if each is not signature.parameters[name].default:
                _require(name, each, hints.get(name, Any), sizes)


def _require(name: str, value: object, hint: Any, sizes: dict[str, int]) -> None:  # noqa: ANN401
    """Raise ArgumentError if a value does not match its annotation."""
    notes: list[object] = []
    if get_origin(hint) is Annotated:
        hint, *notes = get_args(hint)
    if not _is(value, hint):
        raise ArgumentError(name, _name(hint), describe(value))
    shape = [note for note in notes if not isinstance(note, Limits)]
    if shape and value is not None:
        _require_shape(name, np.shape(cast("Any", value)), shape, sizes)
    for note in notes:
        if isinstance(note, Limits) and value is not None and (note.high in sizes or not isinstance(note.high, str)):
            note.require(name, np.asarray(value), sizes)


def _require_shape(name: str, got: tuple[int, ...], shape: Sequence[Any], sizes: dict[str, int]) -> None:
    expected = [sizes.get(length, length) if isinstance(length, str) else length for length in shape]
    fits = len(got) == len(expected) and all(
        not isinstance(want, int) or want == have for want, have in zip(expected, got, strict=True)
    )
    if not fits:
        raise ArgumentError(name, f"shape ({', '.join(str(n) for n in expected)})", got)
    sizes.update((length, have) for length, have in zip(shape, got, strict=True) if isinstance(length, str))


def _is(value: Any, hint: Any) -> bool:  # noqa: ANN401
    """Return whether a value is of a type, as an annotation gives it."""
    origin, items = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_is(value, item) for item in _alternatives(items))
    if hint is _Numbers:
        return _is_numeric(value)
    if origin is Annotated:
        return _is(value, items[0])
    if origin is Literal:
        return isinstance(value, str | int) and value in items
    if origin is np.ndarray:
        return isinstance(value, np.ndarray) and _is_of_dtype(value, get_args(items[1])[0])
    if hint in _NUMBERS:
        return _is_number(value, hint)
    if hint in (None, NoneType):
        return value is None
    if origin is type:
        return isinstance(value, type)
    if origin is not None:
        return isinstance(value, origin) and _has_items(value, origin, items)
    return not isinstance(hint, type) or hint in (Any, object) or _is_instance(value, hint)


def _alternatives(items: tuple[Any, ...]) -> list[Any]:
    """Alternatives of a union; NumPy's `ArrayLike` counts as one of them."""
    of_arrays = get_args(ArrayLike)
    if not set(of_arrays) <= set(items):
        return [*items]
    return [_Numbers, *(item for item in items if item not in of_arrays)]


def _is_instance(value: object, kind: type) -> bool:
    try:
        return isinstance(value, kind)
    except TypeError:  # a Protocol that states attributes alone
        return True


def _is_number(value: Any, kind: object) -> bool:  # noqa: ANN401
    if not isinstance(value, _NUMBERS[kind]) or (isinstance(value, bool) and kind is not bool):
        return False
    return not isinstance(value, int | np.integer) or abs(int(value)) <= _LARGEST


def _is_of_dtype(array: NDArray[Any], scalar: Any) -> bool:  # noqa: ANN401
    scalar = get_origin(scalar) or scalar  # of np.integer[Any]
    if scalar is Any or not isinstance(scalar, type):
        return not array.dtype.hasobject
    kind = "i" if scalar is np.integer else np.dtype(scalar).kind
    return array.dtype.kind in _KINDS.get(kind, kind) and array.dtype.isnative


def _is_numeric(value: Any) -> bool:  # noqa: ANN401
    """Return whether an array of numbers can be made of a value."""
    try:
        return np.asarray(value).dtype.kind in "fiub"
    except (ValueError, TypeError, OverflowError):
        return False


def _has_items(value: Any, origin: Any, items: tuple[Any, ...]) -> bool:  # noqa: ANN401
    """Return whether the items of a container have the stated types; iterators are not consumed."""
    if issubclass(origin, Mapping):
        return all(_is(key, items[0]) and _is(each, items[1]) for key, each in value.items())
    if origin is tuple and not (len(items) == 2 and items[1] is Ellipsis):
        return len(value) == len(items) and all(_is(each, item) for each, item in zip(value, items, strict=True))
    if issubclass(origin, Collection) or (issubclass(origin, Iterable) and isinstance(value, list | tuple)):
        return not isinstance(value, str | bytes) and all(_is(each, items[0]) for each in value)
    return True


def _name(hint: Any) -> str:  # noqa: ANN401
    """Return an annotation in a message."""
    origin, items = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(_name(item) for item in _alternatives(items))
    if origin is np.ndarray:
        return f"an array of {getattr(get_args(items[1])[0], '__name__', 'numbers')}"
    if origin is Literal:
        return f"one of {', '.join(repr(item) for item in items)}"
    if origin is Annotated:
        return _name(items[0])
    if hint is _Numbers:
        return "numbers"
    if hint is int:
        return "int of at most 62 bits"
    if hint is float:
        return "a number"
    return str(getattr(hint, "__name__", hint)).replace("NoneType", "None")
