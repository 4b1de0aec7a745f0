"""Errors pass from one process to another: a pool of workers raises what a worker has raised."""

import pickle
from pathlib import Path

import pytest

from gridslam.errors import (
    ArgumentError,
    ConfigurationError,
    ConsumedStateError,
    InputError,
    MissingDependencyError,
    OutputError,
)

ERRORS = [
    ArgumentError("beams", "a number", "many"),
    ConfigurationError("no such preset"),
    ConsumedStateError(),
    InputError("a.csv", "no header", 3),
    MissingDependencyError("the page", "aiohttp", "live"),
    OutputError("cannot be written"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_is_the_same_in_another_process(error):
    error.add_note("in the second log")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_attributes_are_there():
    again = pickle.loads(pickle.dumps(ERRORS[3]))
    assert (again.path, again.line) == (Path("a.csv"), 3)
