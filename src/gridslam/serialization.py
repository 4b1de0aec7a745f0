"""Convert states to plain arrays with dotted names, and back, by the fields of their classes.

A state is a dataclass or a named tuple. Its fields are numbers, texts, enumerators, tuples of numbers, arrays, other
states, and lists and dicts of all these; of a list of states each field is one array, along the list. Where arrays in a
list differ in length, they follow each other in one array, and `counts` has their lengths. A field that is None is
absent. A class with methods `to_arrays` and `from_arrays` is saved by them.

Annotations state what must agree, which is checked when a state is restored. `Annotated[FloatArray, "N", 3]` has three
columns and as many rows as whatever else is annotated with N in the state, or in one that holds it;
`Annotated[TileMaps, "N"]` is that long, and the number of steps of `Annotated[Ancestry, Size("T", "steps")]` is T.
`Annotated[int, index_of("N")]` is the number of such a row.
"""

from __future__ import annotations

import dataclasses
from collections import ChainMap, Counter
from collections.abc import Callable, Hashable, Mapping, MutableMapping
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, Union, cast, final, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import COUNT, Limits, Size
from gridslam.errors import ArgumentError

NOT_SAVED: Mapping[str, Any] = {"is_saved": False}
"""Metadata of a field that follows from the others, or that a restored state does without."""

_State = TypeVar("_State")
_Arrays = Mapping[str, NDArray[Any]]
_Restore = Callable[[_Arrays], object]
_Shape = tuple[Any, ...]  # of int, str and None: see `read_array`
_Sizes = MutableMapping[str, int]


def to_arrays(state: object) -> dict[str, NDArray[Any]]:
    """Return a copy of all that is saved of a state as plain arrays by dotted names."""
    arrays: dict[str, NDArray[Any]] = {}
    for field, (name, form) in _saved_fields(cast("Hashable", type(state))).items():
        value = getattr(state, field)
        if value is not None:
            arrays |= _dump(name, form, value)
    return arrays


def from_arrays(kind: type[_State], arrays: _Arrays, restore: Mapping[type, _Restore] | None = None) -> _State:
    """Restore a state from the arrays of `to_arrays`.

    Parameters
    ----------
    kind : type
        Class of the state.
    arrays : mapping of str to array
        Arrays by name; others among them are ignored.
    restore : mapping of type to callable, optional
        Functions that restore objects of a class from their own arrays, in place of the class's `from_arrays`.

    Raises
    ------
    ArgumentError
        An array is missing, or its type or shape is wrong.
    """
    return cast("_State", _Reader(arrays, restore or {}).read(kind))


def select_part(arrays: _Arrays, part: str) -> dict[str, NDArray[Any]]:
    """Select the arrays whose names begin with `part` and a dot, without both."""
    return {name[len(part) + 1 :]: values for name, values in arrays.items() if name.startswith(part + ".")}


def read_array(
    arrays: _Arrays, name: str, dtype: type | str, shape: _Shape | None = None, sizes: _Sizes | None = None
) -> NDArray[Any]:
    """Copy an array of a given type and shape.

    Parameters
    ----------
    shape : tuple of int, str and None, optional
        Lengths along the axes; None is any, and a text any that is the same wherever that text occurs.
    sizes : dict of str to int, optional
        Lengths by text; those that are met for the first time are added.

    Raises
    ------
    ArgumentError
        There is no such array, or it is of another type or shape.
    """
    if name not in arrays:
        raise ArgumentError("arrays", f"an array named {name}", sorted(arrays))
    values = np.array(arrays[name])
    known = {} if sizes is None else sizes
    expected = values.shape if shape is None else tuple(known.get(n, n) if isinstance(n, str) else n for n in shape)
    fits = values.ndim == len(expected) and all(
        not isinstance(want, int) or want == got for want, got in zip(expected, values.shape, strict=True)
    )
    is_typed = values.dtype.kind == "U" if dtype is np.str_ else values.dtype == dtype
    if not is_typed or not fits:
        lengths = ", ".join("any" if n is None else str(n) for n in expected)
        raise ArgumentError(name, f"{np.dtype(dtype)} of shape ({lengths})", f"{values.dtype} of shape {values.shape}")
    known.update((n, got) for n, got in zip(shape or (), values.shape, strict=False) if isinstance(n, str))
    return values


@final
class _Form(NamedTuple):
    """Class and shape of the values of a field, by its annotation."""

    kind: type  # class of the values, without the classes of what they contain
    items: tuple[Any, ...]  # annotations of what they contain
    shape: _Shape | None  # of the array of one value; None where nothing is annotated
    is_optional: bool
    limits: Limits | None  # of the integers, or of the length
    sizes: tuple[Size, ...]  # that it determines

    @property
    def is_state(self) -> bool:
        """Whether the values are saved field by field."""
        return dataclasses.is_dataclass(self.kind) or hasattr(self.kind, "_fields")

    @property
    def is_ragged(self) -> bool:
        """Whether the arrays of values may differ in length."""
        return any(not isinstance(length, int) for length in self.shape or ())

    @property
    def dtype(self) -> type:
        """Type of the numbers."""
        if self.kind is np.ndarray:
            return cast("type", get_args(self.items[1])[0])
        if self.kind is tuple:
            return _form(self.items[0]).dtype
        return {bool: np.bool_, int: np.int64, float: np.float64}.get(self.kind, np.str_)

    def convert(self, name: str, values: NDArray[Any]) -> object:
        """Return the value that an array stands for."""
        if self.kind is np.ndarray:
            return values
        if issubclass(self.kind, Enum):
            if str(values) not in self.kind.__members__:
                raise ArgumentError(name, f"one of {', '.join(self.kind.__members__)}", values)
            return self.kind[str(values)]
        return tuple(values.tolist()) if self.kind is tuple else values.item()


@cache
def _form(annotation: Hashable) -> _Form:
    choice = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else ()
    kind = next((of for of in choice if of is not NoneType), annotation)
    shape: _Shape | None = None
    notes: list[object] = []
    if get_origin(kind) is Annotated:
        kind, *notes = get_args(kind)
        shape = tuple(note for note in notes if not isinstance(note, Limits | Size)) or None
    items = get_args(kind)
    origin = cast("type", get_origin(kind) or kind)
    if origin is Counter:
        items += (Annotated[int, COUNT],)
    elif origin is tuple:
        shape = (None,) if items[-1] is Ellipsis else (len(items),)
    elif not items and shape is None:
        shape = ()
    limits = next((note for note in notes if isinstance(note, Limits)), None)
    sizes = tuple(note for note in notes if isinstance(note, Size))
    return _Form(origin, items, shape, NoneType in choice, limits, sizes)


@cache
def _saved_fields(kind: Hashable) -> dict[str, tuple[str, _Form]]:
    """The fields of a class of states that are saved: the name of the array, and the form, by the name of the field."""
    annotations = get_type_hints(kind, include_extras=True)
    if dataclasses.is_dataclass(kind):
        saved = [field.name for field in dataclasses.fields(kind) if field.metadata != NOT_SAVED]
        annotations = {name: annotations[name] for name in saved}
    return {name: (name.strip("_"), _form(annotation)) for name, annotation in annotations.items()}


def _dump(name: str, form: _Form, value: Any) -> dict[str, NDArray[Any]]:  # noqa: ANN401 whatever a state holds
    if form.is_state or hasattr(value, "to_arrays"):
        nested = value.to_arrays() if hasattr(value, "to_arrays") else to_arrays(value)
        return {f"{name}.{inner}": values for inner, values in nested.items()}
    if isinstance(value, dict):
        keys = _dump_column(f"{name}.keys", _form(form.items[0]), list(value))
        return keys | _dump_column(name, _form(form.items[1]), list(value.values()))
    if isinstance(value, list):
        return _dump_column(name, _form(form.items[0]), value)
    return {name: np.array(value.name if isinstance(value, Enum) else value, form.dtype)}


def _dump_column(name: str, form: _Form, values: list[Any]) -> dict[str, NDArray[Any]]:
    shape = form.shape or ()
    if form.is_state:
        columns: dict[str, NDArray[Any]] = {}
        for field, (inner, of) in _saved_fields(form.kind).items():
            columns |= _dump_column(f"{name}.{inner}", of, [getattr(value, field) for value in values])
        return columns
    if form.is_ragged:
        nothing = np.empty((0, *shape[1:]), form.dtype)
        counts = np.array([len(value) for value in values], np.int64)
        return {f"{name}.counts": counts, name: np.concatenate([nothing, *values])}
    plain = [value.name if isinstance(value, Enum) else value for value in values]
    return {name: np.array(plain, form.dtype).reshape(len(values), *shape)}


@final
class _Reader:
    """Restores a state and those that it holds from the arrays whose names begin with `prefix`."""

    def __init__(
        self, arrays: _Arrays, restore: Mapping[type, _Restore], prefix: str = "", sizes: _Sizes | None = None
    ) -> None:
        self.arrays = arrays
        self.restore = restore
        self.prefix = prefix
        self.sizes = ChainMap[str, int]({}) if sizes is None else ChainMap({}, sizes)
        self.limited: list[tuple[str, NDArray[Any], Limits]] = []

    def read(self, kind: type) -> object:
        """Restore a state, once all its fields are known to agree."""
        fields: dict[str, object] = {}
        for field, (inner, form) in _saved_fields(kind).items():
            name = self.prefix + inner
            is_absent = form.is_optional and not any(f"{other}.".startswith(f"{name}.") for other in self.arrays)
            fields[field] = None if is_absent else self._read_field(name, form)
        own = [(name, values, limits) for name, values, limits in self.limited if self._knows(limits)]
        for name, values, limits in own:
            limits.require(name, values, self.sizes)
        self.limited = [each for each in self.limited if not self._knows(each[2])]  # for a state that holds this one
        return kind(**fields)

    def _knows(self, limits: Limits) -> bool:
        return not isinstance(limits.high, str) or limits.high in self.sizes

    def _read_field(self, name: str, form: _Form) -> object:
        own_restore = self.restore.get(form.kind, getattr(form.kind, "from_arrays", None))
        if own_restore is not None:
            return self._measure(name, form, self._read_part(name, own_restore))
        if form.is_state:
            inner = _Reader(self.arrays, self.restore, name + ".", self.sizes)
            value = inner.read(form.kind)
            self.limited += inner.limited
            return self._measure(name, form, value)
        if form.kind in (dict, Counter):
            keys = self._read_column(f"{name}.keys", _form(form.items[0]), name)
            values = self._read_column(name, _form(form.items[1]), name)
            return form.kind(dict(zip(keys, values, strict=True)))
        if form.kind is list:
            return self._read_column(name, _form(form.items[0]), form.shape[0] if form.shape else name)
        return form.convert(name, self._read_array(name, form, form.shape))

    def _read_part(self, name: str, restore: _Restore) -> object:
        """Restore an object by its own function, which names its arrays without `name`."""
        try:
            return restore(select_part(self.arrays, name))
        except ArgumentError as error:
            raise ArgumentError(f"{name}.{error.argument}", error.expected, error.got) from None

    def _measure(self, name: str, form: _Form, value: Any) -> object:  # noqa: ANN401 whatever a state holds
        """Compare the sizes of an object with those that are known, or learn them."""
        sizes = [(size.name, size.of(value)) for size in form.sizes]
        if form.shape:
            sizes.append((form.shape[0], len(value)))
        for size, got in sizes:
            expected = self.sizes.setdefault(size, got) if isinstance(size, str) else size
            if got != expected:
                raise ArgumentError(
                    name, f"a length of {expected}" + (f", as {size} has" if isinstance(size, str) else ""), got
                )
        if form.limits is not None:
            self.limited.append((name, np.array([len(value)]), form.limits))
        return value

    def _read_array(self, name: str, form: _Form, shape: _Shape | None) -> NDArray[Any]:
        values = read_array(self.arrays, name, form.dtype, shape, self.sizes)
        limits = form.limits or (_form(form.items[0]).limits if form.kind is tuple else None)
        if limits is not None:
            self.limited.append((name, values.reshape(-1), limits))
        return values

    def _read_column(self, name: str, form: _Form, rows: int | str | None) -> list[Any]:
        """Restore a list of `rows` values."""
        shape = form.shape or ()
        if form.is_state:
            fields = _saved_fields(form.kind)
            columns = [self._read_column(f"{name}.{inner}", of, rows) for inner, of in fields.values()]
            return [form.kind(**dict(zip(fields, row, strict=True))) for row in zip(*columns, strict=True)]
        if form.is_ragged:
            counts = read_array(self.arrays, f"{name}.counts", np.int64, (rows,), self.sizes)
            if (counts < 0).any():
                raise ArgumentError(f"{name}.counts", "numbers >= 0", counts.min())
            whole = self._read_array(name, form, (sum(counts.tolist()), *shape[1:]))
            values = np.split(whole, np.cumsum(counts))[:-1]
        else:
            values = list(self._read_array(name, form, (rows, *shape)))
        return [form.convert(name, value) for value in values]
