"""All files of a run, or none."""

import json
import os

import pytest

from gridslam.errors import ArgumentError, OutputError
from gridslam.io.output import OutputFolder, written_aside


def listing(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


@pytest.mark.parametrize("nested", ["out", "a/b/out"])
def test_a_new_folder_appears_whole(tmp_path, nested):
    out = tmp_path / nested
    with OutputFolder(out) as output:
        output.file("map.pgm").write_text("map")
        output.write_json("run.json", {"schema": "gridslam.run/1", "n": 3})
        assert not out.exists()
    assert set(listing(out)) == {"map.pgm", "run.json"}
    assert json.loads((out / "run.json").read_text()) == {"schema": "gridslam.run/1", "n": 3}
    assert [path.name for path in tmp_path.iterdir()] == [nested.split("/")[0]]


def test_others_stay_and_namesakes_are_replaced(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "map.pgm").write_text("old")
    with OutputFolder(tmp_path) as output:
        output.file("map.pgm").write_text("new")
        output.file("run.json").write_text("{}")
        assert (tmp_path / "map.pgm").read_text() == "old"
    assert listing(tmp_path) == {"mine.txt": "mine", "map.pgm": "new", "run.json": "{}"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_failed_run_leaves_no_trace(tmp_path, error):
    (tmp_path / "map.pgm").write_text("old")
    def run(out):
        with OutputFolder(out) as output:
            output.file("map.pgm").write_text("half")
            raise error

    for out in (tmp_path, tmp_path / "new"):
        with pytest.raises(error):
            run(out)
        assert listing(tmp_path) == {"map.pgm": "old"}


@pytest.mark.parametrize("after", range(5))
@pytest.mark.parametrize("before_move", [True, False])
def test_an_interrupt_amid_the_moves_undoes_them(tmp_path, monkeypatch, after, before_move):
    """Five moves: two files are put aside and replaced, one is new."""
    (tmp_path / "a").write_text("old a")
    (tmp_path / "b").write_text("old b")
    moves, move = [0], os.replace

    def interrupted(source, target):
        moves[0] += 1
        if moves[0] == after + 1 and before_move:
            raise KeyboardInterrupt
        move(source, target)
        if moves[0] == after + 1:
            raise KeyboardInterrupt

    def run():
        with OutputFolder(tmp_path) as output:
            for name in "abc":
                output.file(name).write_text("new")
            monkeypatch.setattr(os, "replace", interrupted)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert listing(tmp_path) == {"a": "old a", "b": "old b"}


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "out").write_text("a file")
    for out in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(OutputError, match="is a file"), OutputFolder(out):
            pytest.fail("the context must not be entered")
    assert listing(tmp_path) == {"out": "a file"}


def test_a_folder_in_the_way_of_a_file(tmp_path):
    (tmp_path / "map.pgm").mkdir()

    def run():
        with OutputFolder(tmp_path) as output:
            output.file("map.pgm").write_text("map")

    with pytest.raises(OutputError, match="got a folder"):
        run()
    assert [path.name for path in tmp_path.iterdir()] == ["map.pgm"]


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    """The refusal is simulated, so that the test holds for a superuser too."""

    def refused(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.mkdir", refused)
    with pytest.raises(OutputError, match=r"cannot be written: Permission denied$"), OutputFolder(tmp_path / "out"):
        pytest.fail("the context must not be entered")


def test_json_needs_a_schema_and_finite_numbers(tmp_path):
    with OutputFolder(tmp_path) as output:
        good = {"schema": "s/1"}
        for document in ({"n": 1}, {"schema": ""}, good | {"x": float("nan")}, good | {"x": object()}):
            with pytest.raises(ArgumentError):
                output.write_json("run.json", document)
    assert listing(tmp_path) == {}


@pytest.mark.parametrize("name", ["", "..", "../x", "a/b", "/x"])
def test_names_are_names(tmp_path, name):
    with OutputFolder(tmp_path) as output, pytest.raises(ArgumentError):
        output.file(name)


def test_written_aside(tmp_path):
    target = tmp_path / "file"

    def fail():
        with written_aside(target) as path:
            path.write_text("half")
            raise KeyError

    with written_aside(target) as path:
        path.write_text("whole")
        assert not target.exists()
    with pytest.raises(KeyError):
        fail()
    assert listing(tmp_path) == {"file": "whole"}
