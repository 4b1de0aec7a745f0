"""All files of a run, or none."""

import json
import os
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

from gridslam.errors import OutputError
from gridslam.io import output
from gridslam.io.output import OutputFolder, remove_abandoned, require_writable, write_atomically


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


def test_an_interrupt_leaves_the_folder_as_it_was(tmp_path):
    (tmp_path / "a").write_text("old a")

    def run():
        with OutputFolder(tmp_path) as out:
            out.file("a").write_text("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    assert listing(tmp_path) == {"a": "old a"}


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "out").write_text("a file")
    for out in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(OutputError, match="is a file"), OutputFolder(out):
            pytest.fail("the context must not be entered")
    assert listing(tmp_path) == {"out": "a file"}


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    """The refusal is simulated, so that the test holds for a superuser too."""

    def refused(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.mkdir", refused)
    with pytest.raises(OutputError, match=r"cannot be written: Permission denied$"), OutputFolder(tmp_path / "out"):
        pytest.fail("the context must not be entered")


PUBLISHER = """
import sys, time
from pathlib import Path
from gridslam.io.output import OutputFolder
for version in range(10**6):
    with OutputFolder(sys.argv[1]) as out:
        for name in ("map.pgm", "map.yaml", "trajectory.tum", "graph.g2o"):
            out.file(name).write_text(f"{version}")
        out.write_json("run.json", {"schema": "s/1", "version": version})
    if not version:
        print("ready", flush=True)
"""


@pytest.mark.parametrize("seed", range(3))
def test_a_run_that_is_killed_while_it_replaces_a_result_leaves_no_run_json_beside_files_of_another(tmp_path, seed):
    out = tmp_path / "out"
    rng = np.random.default_rng(seed)
    for _ in range(8):
        run = subprocess.Popen([sys.executable, "-c", PUBLISHER, str(out)], stdout=subprocess.PIPE)
        assert run.stdout.readline() == b"ready\n"
        (out / "mine.txt").write_text("mine")
        time.sleep(rng.uniform(0.0, 0.05))
        run.kill()
        run.communicate()
        files = {path.name: path.read_text() for path in out.iterdir() if path.is_file()}
        assert files.pop("mine.txt") == "mine"
        if "run.json" not in files:
            continue
        version = json.loads(files.pop("run.json"))["version"]
        assert files == dict.fromkeys(("map.pgm", "map.yaml", "trajectory.tum", "graph.g2o"), f"{version}")


def test_what_a_living_process_is_writing_stays(tmp_path):
    with OutputFolder(tmp_path / "out") as first:
        first.file("map.pgm").write_text("one")
        with OutputFolder(tmp_path / "out") as second:
            second.file("map.pgm").write_text("two")
        with OutputFolder(tmp_path / "out"):
            assert first.file("map.pgm").read_text() == "one"
    assert listing(tmp_path / "out") == {"map.pgm": "one"}


def test_all_files_of_a_folder_are_stored_before_it_appears(tmp_path, monkeypatch):
    """Else a loss of power would leave a folder whose files are empty."""
    stored = []
    monkeypatch.setattr(output, "sync", lambda *paths: stored.extend(path.name for path in paths))
    with write_atomically(tmp_path / "bag") as path:
        (path / "inner").mkdir(parents=True)
        (path / "inner" / "data.db3").touch()
    assert sorted(stored[:3]) == ["bag", "data.db3", "inner"]


def test_a_link_to_nothing_is_no_folder(tmp_path):
    (tmp_path / "out").symlink_to(tmp_path / "gone")
    for out in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(OutputError, match="out is a link to nothing"), OutputFolder(out):
            pytest.fail("the context must not be entered")


def test_what_a_killed_process_has_left_is_removed_by_its_name(tmp_path):
    """A job of a batch that fails takes nothing from one that runs beside it, whose name begins alike."""
    for name in ("run", "run.2", "other"):
        (tmp_path / f".{name}.abcdefg8.partial").mkdir()
    (tmp_path / "run").mkdir()
    remove_abandoned(tmp_path, "run")
    assert {path.name for path in tmp_path.iterdir()} == {".run.2.abcdefg8.partial", ".other.abcdefg8.partial", "run"}
    remove_abandoned(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_interrupt_while_a_check_is_cleaned_up_leaves_nothing(tmp_path, monkeypatch):
    """The folder that is made to see whether there can be one is removed, whenever the user interrupts."""

    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(tempfile.TemporaryDirectory, "_rmtree", interrupt)
    with pytest.raises(KeyboardInterrupt):
        require_writable(tmp_path / "out", is_folder=True)
    assert not list(tmp_path.iterdir())


def test_an_interrupt_while_the_folder_aside_is_made_leaves_nothing(tmp_path, monkeypatch):
    """It comes when the folder is there, before its name is returned; what another run has written stays."""
    (tmp_path / ".out.12345678.partial" / "out").mkdir(parents=True)

    make = os.mkdir

    def interrupt(name, *args):
        make(name)
        raise KeyboardInterrupt

    monkeypatch.setattr("tempfile._os.mkdir", interrupt)
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path / "out"):
        pass
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == [".out.12345678.partial"]
