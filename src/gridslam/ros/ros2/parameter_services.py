"""The services by which `ros2 param` lists, reads and sets the parameters of a node.

Source: the interfaces of the package rcl_interfaces, https://github.com/ros2/rcl_interfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias, final

from gridslam.io.bags.encoder import Values

_NOT_SET, _BOOL, _INTEGER, _DOUBLE, _STRING, _ARRAYS = range(6)
_FIELDS: Final = ("bool_value", "integer_value", "double_value", "string_value")
_NOTHING: Final[Values] = (False, 0, 0.0, "", [], [], [], [], [])
_AT_START: Final = "read when the node starts"

Report: TypeAlias = Callable[[Sequence[Values], Sequence[Values]], None]
"""Called with the parameters that are new, and with those that have changed, as values of rcl_interfaces/Parameter."""

_MAX_INTEGER: Final = 2**63


@final
class ParameterServices:
    """Answers of a node's parameter services.

    Parameters
    ----------
    values : mapping
        Parameters by name: bool, int, float, str, or sequences of those.
    change : callable
        Called with name and value; returns why it cannot be set, or "". Names in `settable` only.
    settable : collection of str
        Parameters that can be set while the node runs.
    report : callable
        Called with all parameters at once, and with those that change from then on.
    """

    def __init__(
        self,
        values: Mapping[str, Any],
        change: Callable[[str, Any], str],
        settable: Sequence[str],
        report: Report = lambda new, changed: None,
    ) -> None:
        self._values = dict(values)
        self._change = change
        self._settable = frozenset(settable)
        self._report = report
        report(self._encode(self._values), [])

    def store(self, values: Mapping[str, Any]) -> None:
        """Set values that the node itself has found."""
        self._values = {**self._values, **values}
        self._report([], self._encode(values))

    def services(self) -> dict[str, tuple[str, Callable[[Any], Sequence[Any]]]]:
        """Return type and answer of each service, by its name below the node's."""
        return {
            "list_parameters": ("rcl_interfaces/ListParameters", self._list),
            "get_parameters": ("rcl_interfaces/GetParameters", self._get),
            "get_parameter_types": ("rcl_interfaces/GetParameterTypes", self._get_types),
            "describe_parameters": ("rcl_interfaces/DescribeParameters", self._describe),
            "set_parameters": ("rcl_interfaces/SetParameters", self._set),
            "set_parameters_atomically": ("rcl_interfaces/SetParametersAtomically", self._set_atomically),
        }

    def _list(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        prefixes = [str(prefix) for prefix in request.prefixes]
        depth = int(request.depth) or _MAX_INTEGER
        names = [
            name
            for name in sorted(self._values)
            if (not prefixes and name.count(".") < depth)
            or any(
                name == prefix or (name.startswith(f"{prefix}.") and name[len(prefix) + 1 :].count(".") < depth)
                for prefix in prefixes
            )
        ]
        return (([*names], sorted({name.rpartition(".")[0] for name in names if "." in name})),)

    def _get(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        return ([_encode_value(self._values.get(name)) for name in request.names],)

    def _get_types(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        return ([_kind_of(self._values.get(name)) for name in request.names],)

    def _describe(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        described: list[Values] = []
        for name in request.names:
            read_only = name in self._values and name not in self._settable
            constraint = _AT_START if read_only else ""
            described.append((name, _kind_of(self._values.get(name)), "", constraint, read_only, False, [], []))
        return (described,)

    def _set(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        return ([self._set_one(parameter.name, _decode_value(parameter.value)) for parameter in request.parameters],)

    def _set_atomically(self, request: Any) -> Sequence[Any]:  # noqa: ANN401
        """Set all if each is settable; one that its type forbids is found by its own check before."""
        wanted = [(parameter.name, _decode_value(parameter.value)) for parameter in request.parameters]
        for name, value in wanted:
            if problem := self._find_problem(name, value):
                return ((False, problem),)
        results = [self._set_one(name, value) for name, value in wanted]
        return (next((result for result in results if not result[0]), (True, "")),)

    def _set_one(self, name: str, value: Any) -> Values:  # noqa: ANN401
        problem = self._find_problem(name, value) or self._change(name, value)
        if not problem:
            self.store({name: value})
        return not problem, problem

    @staticmethod
    def _encode(values: Mapping[str, Any]) -> list[Values]:
        """Return the values of rcl_interfaces/Parameter."""
        return [(name, _encode_value(value)) for name, value in values.items()]

    def _find_problem(self, name: str, value: Any) -> str:  # noqa: ANN401
        """Return why a parameter cannot be set; empty if it can."""
        if name not in self._values:
            return f"there is no parameter {name}"
        if name not in self._settable:
            return f"{name} is {_AT_START}: start it with -p {name}:=VALUE"
        now = self._values[name]
        if _kind_of(value) != _kind_of(now):
            return f"{name}: expected a value like {now!r}, got {value!r}"
        return ""


def _kind_of(value: Any) -> int:  # noqa: ANN401
    """Return rcl_interfaces/ParameterType."""
    if isinstance(value, bool):
        return _BOOL
    if isinstance(value, int) and abs(value) < _MAX_INTEGER:
        return _INTEGER
    if isinstance(value, float):
        return _DOUBLE
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        kinds = {_kind_of(one) for one in value}
        return _ARRAYS + kinds.pop() if len(kinds) == 1 and kinds <= {_BOOL, _INTEGER, _DOUBLE} else _ARRAYS + _STRING
    return _NOT_SET if value is None else _STRING


def _encode_value(value: Any) -> Values:  # noqa: ANN401
    """Return the fields of rcl_interfaces/ParameterValue."""
    kind = _kind_of(value)
    fields = list(_NOTHING)
    if kind == _ARRAYS + _STRING:
        fields[kind - 1] = [str(one) for one in value]
    elif kind != _NOT_SET:
        fields[kind - 1] = str(value) if kind == _STRING else value
    return kind, *fields


def _decode_value(value: Any) -> Any:  # noqa: ANN401
    """Return the value of rcl_interfaces/ParameterValue; None for lists, which no settable parameter is."""
    return getattr(value, _FIELDS[value.type - 1]) if _NOT_SET < value.type <= _STRING else None
