"""Every number of a configuration at its extremes: the run ends well or is refused by name, within bounds."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from pydantic import TypeAdapter

import gridslam
from gridslam.config.configuration import Configuration
from gridslam.config.tables import nest, replace_parameters
from gridslam.errors import ConfigurationError, GridslamError
from gridslam.io.carmen.writer import write_carmen
from gridslam.parameters import Kind
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.children import run_in_child

VALUES = (0, -1, 1e-300, 1e-9, 1e9, 1e300, 2**63, 10**30)
NOT_FINITE = (math.nan, math.inf)


@dataclass(frozen=True)
class Number:
    """A parameter that is a number: its dotted name, the kinds of the parts that hold it, and its bounds if any."""

    name: str
    kinds: tuple[tuple[str, str], ...]
    schema: tuple[tuple[str, float], ...]

    def changes(self, value: float) -> dict[str, Any]:
        """What makes a configuration hold the value."""
        return nest({**{f"{part}.kind": kind for part, kind in self.kinds}, self.name: value})

    @property
    def bounds(self) -> list[float]:
        """The least and the greatest value that are allowed, or one beside them."""
        found = dict(self.schema)
        steps = {"minimum": 0.0, "exclusiveMinimum": 1e-9, "maximum": 0.0, "exclusiveMaximum": -1e-9}
        values = [found[bound] + step for bound, step in steps.items() if bound in found]
        return [int(value) if "integer" in found and math.isfinite(value) else value for value in values]


def numbers(part: type = Configuration, name: str = "", kinds: tuple[tuple[str, str], ...] = ()) -> Iterator[Number]:
    """All numbers of a tree of parameters, of all kinds of its parts."""
    properties = _properties(part)
    hints = get_type_hints(part, include_extras=True)
    for field in fields(part):
        path = f"{name}.{field.name}" if name else field.name
        classes = [each for each in _classes(hints[field.name]) if each is not type(None)]
        has_kinds = any(isinstance(note, Kind) for note in getattr(hints[field.name], "__metadata__", ()))
        for each in classes:
            yield from numbers(each, path, (*kinds, (path, each.__name__)) if has_kinds else kinds)
        schema = properties.get(field.name, {})
        for form in (schema, *schema.get("anyOf", ())):
            if form.get("type") in ("number", "integer"):
                bounds = {key: limit for key, limit in form.items() if key.lower().endswith("imum")}
                yield Number(path, kinds, tuple((bounds | {form["type"]: 1.0}).items()))


def _properties(part: type) -> dict[str, Any]:
    schema = TypeAdapter(part).json_schema()
    found: dict[str, Any] = schema["properties"]
    return found


def _classes(hint: Any) -> list[type]:
    """The parameter classes of an annotation."""
    inner = get_args(hint)
    if inner:
        return [part for each in inner for part in _classes(each)]
    return [hint] if isinstance(hint, type) and hasattr(hint, "__pydantic_config__") else []


def cases() -> list[tuple[Number, float]]:
    """Every number with each extreme, its own bounds among them."""
    return [(number, value) for number in numbers() for value in (*number.bounds, *VALUES, *NOT_FINITE)]


@cache
def _log() -> Path:
    """A log in which the robot comes back to where it was, as the closing of loops has to be reached."""
    rng = np.random.default_rng(3)
    laser = LidarConfig(beams=72, field_of_view_rad=math.tau, rate_hz=1.0)
    simulated = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), laser, rng)
    path = Path(tempfile.mkdtemp()) / "rooms.clf"
    write_carmen(path, simulated.measurements)
    return path


def run_case(number: Number, value: float) -> str:
    """What came of it: "refused" or "mapped"; anything else is a failure."""
    base = replace_parameters(Configuration(), {"particles": 8, "range_max_m": 12.0})
    try:
        configuration = replace_parameters(base, number.changes(value))
    except ConfigurationError as error:
        named = number.name.rpartition(".")[2] in str(error) or "inverse_sensor" in str(error)
        return "refused" if named else f"refused, but not by name: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    log = _log()
    return run_in_child(lambda: _map(log, configuration))


def _map(log: Path, configuration: Configuration) -> str:
    try:
        gridslam.map_log(log, configuration=configuration)
    except GridslamError:
        return "refused"
    return "mapped"


def run_cases(chosen: list[tuple[Number, float]]) -> tuple[Counter[str], dict[str, str]]:
    """How many were mapped and refused, and what came of all others, by name and value."""
    came = Counter[str]()
    failures = dict[str, str]()
    for number, value in chosen:
        result = run_case(number, value)
        came[result if result in ("mapped", "refused") else "failed"] += 1
        if result not in ("mapped", "refused"):
            kinds = "".join(f" {part}.kind={kind}" for part, kind in number.kinds)
            failures[f"{number.name}={value!r}{kinds}"] = result
    return came, failures
