"""Public functions check their arguments by their annotations, where a caller enters the package and nowhere else."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import FunctionType
from typing import Annotated, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import Limits, index_of
from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.types import FloatArray, LaserScan, Points, Poses, Rows


@checked
def add(poses: Poses, rows: Annotated[Rows, "K", Limits(0, 9)], scale: float = 1.0) -> float:
    """Add what belongs together."""
    return float(poses.sum() * scale + rows.sum())


@checked
def take(
    count: int = 0,
    share: Annotated[float, Limits(0, 1)] = 0.0,
    name: str = "",
    path: str | Path | None = None,
    numbers: ArrayLike = 0,
    mode: Literal["fast", "slow"] = "fast",
    pair: tuple[float, str] = (0.0, ""),
    many: Sequence[int] = (),
    table: Mapping[str, float] | None = None,
    call: Callable[[], None] = lambda: None,
    flags: NDArray[np.bool_] | None = None,
    scan: LaserScan | None = None,
) -> tuple[object, ...]:
    """Take one of each."""
    return count, share, name, path, numbers, mode, pair, many, table, call, flags, scan


@checked
@functools.wraps(take)
def use(*arguments: object, **named: object) -> None:
    """Fail on whatever it gets, with the signature of `take`."""
    raise TypeError("deep within")


@checked
@dataclass
class Table:
    """Has rows."""

    rows: Points

    def __len__(self) -> int:
        return len(self.rows)

    def row(self, number: Annotated[int, index_of("self")]) -> FloatArray:
        """One row."""
        return self.rows[number]

    @classmethod
    def of(cls, count: int) -> Table:
        """A table of zeros."""
        return cls(np.zeros((count, 2)))

    @staticmethod
    def side(count: int) -> int:
        """Twice a count."""
        return 2 * count


def test_what_is_annotated_passes():
    assert add(np.ones((2, 3)), np.array([1, 2], np.int32), scale=np.float32(2)) == 15
    assert add(np.ones((2, 3), np.int64), np.array([1, 2])) == 9
    values = {
        "count": np.int32(3), "share": 1, "name": "a", "path": Path("a"), "numbers": [[1, 2], [3, 4]], "mode": "slow",
        "pair": (1, "b"), "many": [1, 2], "table": {"a": 1.5}, "call": print, "flags": np.ones(2, np.bool_),
    }  # fmt: skip
    assert take(**values)[:4] == (3, 1, "a", Path("a"))
    assert take(share=float(1), path=None, scan=None)[1] == 1
    assert take(numbers=np.nan)[4] is np.nan


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("count", 1.5), ("count", True), ("count", "1"), ("count", 10**30), ("count", None), ("count", 2**63),
        ("share", "x"), ("share", 1.5), ("share", -0.1), ("share", float("nan")), ("share", None), ("share", 1j),
        ("name", b"x"), ("path", 3), ("numbers", "x"), ("numbers", [1, [2]]), ("numbers", None), ("numbers", [10**30]),
        ("mode", "other"), ("pair", (1.0,)), ("pair", ("b", 1.0)), ("pair", 3), ("many", 3), ("many", "abc"),
        ("many", [1, "x"]), ("table", {1: 2.0}), ("table", [1]), ("call", 3), ("flags", np.ones(2)), ("scan", "scan"),
    ],
)  # fmt: skip
def test_what_is_not_annotated_is_refused_by_name(name, wrong):
    with pytest.raises(ArgumentError, match=rf"^{name}: expected .*, got ") as caught:
        use(**{name: wrong})
    assert caught.value.argument == name


@pytest.mark.parametrize(
    ("poses", "rows", "named"),
    [
        (np.ones((2, 2)), np.zeros(2, np.int32), "poses"),
        (np.ones(3), np.zeros(1, np.int32), "poses"),
        (np.ones((2, 3)), np.zeros(3, np.int32), "rows"),
        (np.ones((2, 3)), np.zeros((2, 1), np.int32), "rows"),
        (np.ones((2, 3)), np.array([0, 10]), "rows"),
        (np.ones((2, 3)), np.array([0, -1]), "rows"),
        (np.ones((2, 3), np.complex128), np.zeros(2, np.int32), "poses"),
        (np.ones((2, 3), ">f8"), np.zeros(2, np.int32), "poses"),
        (np.ones((2, 3)), np.zeros(2), "rows"),
        (np.ones((2, 3)).tolist(), np.zeros(2, np.int32), "poses"),
    ],
)
def test_shapes_types_and_ranges_of_arrays(poses, rows, named):
    with pytest.raises(ArgumentError, match=f"^{named}: expected"):
        add(poses, rows)


def test_a_wrong_number_of_arguments_is_a_type_error():
    with pytest.raises(TypeError, match="missing a required argument"):
        add(np.ones((2, 3)))
    with pytest.raises(TypeError, match="unexpected keyword"):
        take(other=1)


def test_methods_know_the_length_of_their_object():
    table = Table(np.arange(6.0).reshape(3, 2))
    assert table.row(2).tolist() == [4, 5]
    assert len(Table.of(2)) == Table.side(1) == 2
    for call in (lambda: table.row(3), lambda: table.row(-1), lambda: Table.of("x"), lambda: Table.side(None)):
        with pytest.raises(ArgumentError, match=r"number|count"):
            call()
    with pytest.raises(ArgumentError, match="rows: expected shape"):
        Table(np.zeros(3))


def test_numbers_that_do_not_go_together_are_an_argument_error_and_faults_stay_what_they_are():
    @checked
    def fail(error: object) -> None:
        raise error

    for error in (
        ValueError("deep within"),
        IndexError("no row"),
        ZeroDivisionError(),
        np.linalg.LinAlgError("singular"),
    ):
        with pytest.raises(ArgumentError, match="arguments that go together") as caught:
            fail(error)
        assert caught.value.__cause__ is error
    for error in (AttributeError("a fault"), TypeError("a fault"), InputError("a", "b"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            fail(error)
    with pytest.raises(ArgumentError, match="share"):
        take(share=2)  # checked again after each


PACKAGES = (
    *("gridslam", "gridslam.config", "gridslam.doctor", "gridslam.evaluation", "gridslam.geometry.angles"),
    *("gridslam.geometry.rigid", "gridslam.geometry.se2", "gridslam.grid"),
    *("gridslam.localization", "gridslam.mapping", "gridslam.matching", "gridslam.models", "gridslam.particles"),
    *("gridslam.sim", "gridslam.slam", "gridslam.transforms", "gridslam.types"),
)
OF_FILTERS = ("GridFastSlamState", "MonteCarloState", "TrackerState", "ReportBuilder", "require_step")
"""What filters alone call, for each scan: they hand in what they have checked."""
UNCHECKED = (
    *(
        "doctor.Repair",
        "gridslam.Diagnosis",
        "doctor.Diagnosis",
    ),
    *("gridslam.Conversion", "gridslam.GridResult", "gridslam.LandmarkLocalizationResult", "gridslam.LandmarkResult"),
    *("gridslam.LocalizationResult", "gridslam.StepReport", "localization.LocalizationReport", "sim.SimulatedLog"),
    *("evaluation.RelationErrors", "evaluation.SelfConsistency", "matching.LatticeMatch"),
    *(
        "slam.ProposedPoses",
        "types.StoredScan",
        "sim.Change",
        "types.StepReport",
        "types.OwnedState",
    ),  # all these the package itself makes
    *("geometry.angles.wrap", "sim.vary_route", "gridslam.run", "types.require_measurement"),
    "geometry.se2.rotate_covariances",  # check by themselves, or serve the package alone
)


def is_checked(function):
    function = getattr(function, "__func__", function)
    takes = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]
    return hasattr(function, "__wrapped__") or not takes


def public_names(module):
    own = getattr(module, "__all__", None) or [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]
    return {name: getattr(module, name) for name in own if name not in OF_FILTERS}


def test_every_public_function_constructor_and_method_is_checked():
    found = set()
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name, public in public_names(module).items():
            whole = f"{package.removeprefix('gridslam.')}.{name}"
            if isinstance(public, FunctionType) and not is_checked(public):
                found.add(whole)
            if isinstance(public, type) and not (
                issubclass(public, Exception | Enum) or getattr(public, "_is_protocol", False)
            ):
                found |= {
                    whole if method == "__init__" else f"{whole}.{method}"
                    for method, function in vars(public).items()
                    if method in ("__init__", "__call__") or not method.startswith("_")
                    if isinstance(function, FunctionType | classmethod | staticmethod) and not is_checked(function)
                }
    assert found == set(UNCHECKED)
