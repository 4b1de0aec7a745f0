"""States go to plain arrays and back by their fields; what does not fit is refused by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, NamedTuple

import numpy as np
import pytest

from gridslam.arguments import Limits, Size, index_of
from gridslam.errors import ArgumentError
from gridslam.serialization import NOT_SAVED, from_arrays, to_arrays
from gridslam.types import FloatArray


class Colour(Enum):
    RED = "red"
    GREEN = "green"


class Edge(NamedTuple):
    from_: int
    colour: Colour
    point: Annotated[FloatArray, 2]
    ends: Annotated[FloatArray, None, 2]


class Shelf:
    """Saved by its own pair."""

    def __init__(self, number, unit=1):
        self.number, self.unit = number, unit

    def to_arrays(self):
        return {"number": np.array(self.number)}

    @classmethod
    def from_arrays(cls, arrays, unit=1):
        return cls(int(arrays["number"]), unit)


@dataclass
class Inner:
    poses: Annotated[FloatArray, "N", 3]
    weights: Annotated[FloatArray, "N"]
    label: str = "none"


@dataclass
class State:
    inner: Inner
    edges: list[Edge]
    by_name: dict[str, Annotated[FloatArray, 3]]
    counts: Counter[Colour]
    pair: tuple[float, float]
    some: tuple[int, ...]
    colour: Colour
    shelf: Shelf
    steps: list[tuple[float, float]] = field(default_factory=list)
    is_lost: bool = False
    covariance: Annotated[FloatArray, 3, 3] | None = None
    other: Inner | None = None
    cache: object = field(default=None, metadata=NOT_SAVED)


def edges(count):
    return [Edge(k, list(Colour)[k % 2], np.array([k, 0.5]), np.full((k, 2), float(k))) for k in range(count)]


def state(count=3, **more):
    inner = Inner(np.arange(6.0).reshape(2, 3), np.array([0.5, 0.5]), "two words")
    names = {"left/scan": np.zeros(3), "b.c": np.ones(3)} if count else {}
    kinds = Counter({Colour.GREEN: 2}) if count else Counter()
    pairs = [(1.0, 2.0)] * count
    return State(inner, edges(count), names, kinds, (0.1, 0.2), (7,) * count, Colour.GREEN, Shelf(4), pairs, **more)


def contents(arrays):
    return {name: (array.dtype, array.shape, array.tobytes()) for name, array in arrays.items()}


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.parametrize("more", [{}, {"covariance": np.eye(3), "other": Inner(np.zeros((0, 3)), np.zeros(0))}])
def test_a_state_comes_back_as_it_was(count, more):
    arrays = to_arrays(state(count, is_lost=True, cache=1, **more))
    assert all(array.dtype.kind in "iufbU" for array in arrays.values())
    read = from_arrays(State, arrays)
    assert contents(to_arrays(read)) == contents(arrays)
    assert (read.pair, read.some, read.colour, read.is_lost) == ((0.1, 0.2), (7,) * count, Colour.GREEN, True)
    assert (read.cache, read.inner.label, read.shelf.number) == (None, "two words", 4)
    assert (read.covariance is None, read.other is None) == (not more, not more)
    assert type(read.counts) is Counter
    assert read.counts[Colour.GREEN] == (2 if count else 0)
    assert type(read.is_lost) is bool
    assert {type(edge.from_) for edge in read.edges} <= {int}
    assert [(edge.from_, edge.colour) for edge in read.edges] == [(e.from_, e.colour) for e in edges(count)]
    for edge, expected in zip(read.edges, edges(count), strict=True):
        np.testing.assert_array_equal(edge.ends, expected.ends)
    assert list(read.by_name) == (["left/scan", "b.c"] if count else [])


def test_names_follow_the_fields():
    arrays = to_arrays(state())
    assert set(arrays) == {
        "inner.poses",
        "inner.weights",
        "inner.label",
        "edges.from",
        "edges.colour",
        "edges.point",
        "edges.ends",
        "edges.ends.counts",
        "by_name",
        "by_name.keys",
        "counts",
        "counts.keys",
        "pair",
        "some",
        "colour",
        "shelf.number",
        "steps",
        "is_lost",
    }
    assert arrays["edges.colour"].tolist() == ["RED", "GREEN", "RED"]
    assert arrays["edges.ends.counts"].tolist() == [0, 1, 2]


def test_whatever_is_missing_is_named():
    arrays = to_arrays(state())
    for name in set(arrays) - {"shelf.number"}:
        with pytest.raises(ArgumentError, match=f"an array named {name}"):
            from_arrays(State, {other: a for other, a in arrays.items() if other != name})


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("inner.poses", np.zeros((2, 2))),
        ("inner.poses", np.zeros((2, 3), np.float32)),
        ("inner.weights", np.zeros(3)),
        ("inner.label", np.array(1)),
        ("edges.from", np.zeros(2, np.int64)),
        ("edges.point", np.zeros((3, 3))),
        ("edges.ends", np.zeros((2, 2))),
        ("edges.ends.counts", np.array([-1, 2, 2])),
        ("edges.colour", np.array(["RED", "GREEN", "BLUE"])),
        ("colour", np.array("BLUE")),
        ("by_name.keys", np.array(["one"])),
        ("pair", np.zeros(3)),
        ("some", np.zeros(2)),
        ("is_lost", np.array(1)),
    ],
)
def test_what_does_not_fit_is_refused_by_name(name, wrong):
    with pytest.raises(ArgumentError, match=name.split(".")[0]):
        from_arrays(State, to_arrays(state()) | {name: wrong})


@dataclass
class Table:
    """Counts its rows, and those of others."""

    rows: Annotated[FloatArray, "T", 2]
    parents: Annotated[list[Annotated[int, index_of("T")]], "T"]
    marked: tuple[Annotated[int, Limits(-1, "T")], ...] = ()

    def __len__(self):
        return len(self.rows)


@dataclass
class Owner:
    table: Annotated[Table, "T", Size("marks", "marked")]
    names: Annotated[list[str], "T"]
    edges: list[Annotated[int, index_of("T")]]
    of_mark: Annotated[int, index_of("marks")] = 0
    part: Annotated[Table, Limits(1, "T")] | None = None
    shelf: Annotated[Shelf, Size("seven", "number")] | None = None


def owner(**more):
    table = Table(np.zeros((3, 2)), [0, 0, 1], (-1, 3))
    return Owner(table, ["a", "b", "c"], [2, 0], **more)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("table.parents", np.array([0, 0, 3])),
        ("table.parents", np.array([0, 0, -1])),
        ("table.parents", np.array([0, 0])),
        ("table.marked", np.array([4])),
        ("table.marked", np.array([-2])),
        ("names", np.array(["a", "b"])),
        ("edges", np.array([3])),
        ("edges", np.array([-1])),
        ("edges", np.array([2**62])),
        ("of_mark", np.array(2)),
    ],
)
def test_an_index_out_of_its_table_is_refused_by_name(name, wrong):
    with pytest.raises(ArgumentError, match=f"^{name}: expected"):
        from_arrays(Owner, to_arrays(owner()) | {name: wrong})


def test_what_an_object_refuses_is_named_from_the_outermost_state_on():
    def refuse(arrays):
        raise ArgumentError("number", "another one", arrays["number"])

    with pytest.raises(ArgumentError, match=r"^shelf\.number: expected another one, got 4"):
        from_arrays(State, to_arrays(state()), {Shelf: refuse})
