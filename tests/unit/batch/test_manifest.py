"""Which logs a batch has, and their names."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridslam.batch.manifest import find_logs
from gridslam.errors import InputError


@pytest.fixture
def tree(tmp_path, monkeypatch):
    for name in (
        "logs/mon/run.clf",
        "logs/mon/run.1.clf.gz",
        "logs/tue/run.clf",
        "logs/tue/run.bag",
        "logs/tue/notes.txt",
        "logs/tue/.hidden.clf",
        "logs/ros2/metadata.yaml",
        "logs/ros2/ros2_0.db3",
        "out/mon_run/run.json",
        "out/tue_run/run.json",
        "out/mon_run/trajectory.csv",
        "out/mon_run/trajectory.tum",
        "out/tue_run/trajectory.tum",
        "out/.x.partial/trajectory.tum",
        "one/run.json",
        "one/trajectory.csv",
        "runs.clf",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(*patterns, **options):
    return {entry.name: entry.log for entry in find_logs(patterns, **options)}


def test_a_folder_stands_for_the_logs_below_it(tree):
    assert names(".") == {
        "run.1": "logs/mon/run.1.clf.gz",
        "mon_run": "logs/mon/run.clf",
        "tue_run.bag": "logs/tue/run.bag",
        "tue_run.clf": "logs/tue/run.clf",
        "ros2": "logs/ros2",
        "runs": "runs.clf",
    }


def test_a_manifest_is_relative_to_its_folder(tree):
    (tree / "logs" / "fleet.csv").write_text(
        '\ufefflog, name ,reference,seed\nmon/run.clf,a,../truth.tum,3\n\n"tue/run.clf",,,\n', encoding="utf-8"
    )
    one, two = find_logs(["logs/fleet.csv"], reference="{name}.tum")
    assert (one.name, one.path, one.options) == ("a", os.fspath(tree / "logs/mon/run.clf"), {"seed": "3"})
    assert one.reference == os.fspath(tree / "truth.tum")
    assert one.where == "logs/fleet.csv, line 2"
    assert (two.name, two.options, two.reference) == ("run", {}, os.fspath(tree / "run.tum"))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("log,seed\n,1\n", r"m.csv, line 2: expected a path in the column log"),
        ("log,name\na.clf,../b\n", r"m.csv, line 2: .* of at most 200 bytes, got '../b'"),
        ("log,name\na.clf,runs.sqlite\n", r"expected the name of a folder"),
        ("log,name\na.clf,x\nb.clf,x\n", r"this log or its name is given twice"),
        (f"log,name\na.clf,{'x' * 201}\n", r"the column name, of at most 200 bytes, got 'xxx"),
        ('log,name\n"a.clf,x\n', r"m.csv, line 2: expected a CSV"),
        ("log\na.clf\n\xff\xfe", r"expected a text file, got binary data"),
    ],
)
def test_a_malformed_manifest_is_refused_with_its_line(tree, text, problem):
    (tree / "m.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=problem):
        find_logs(["m.csv"])


def test_a_folder_that_cannot_be_read_is_a_log_that_fails(tree, monkeypatch):
    iterate = Path.iterdir

    def refuse_one(path):
        if path.name == "mon":
            raise PermissionError(13, "Permission denied")
        return iterate(path)

    monkeypatch.setattr(Path, "iterdir", refuse_one)
    assert "logs/mon" in names("logs").values()


CELLS = st.sampled_from(
    ["log", "name", "reference", "seed", "a.clf", "b.clf", "x", "", '"', "\\", "/", "\x00", "s3://a/b"]
)
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=4).map(",".join), max_size=5)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=ROWS, more=st.binary(max_size=8))
def test_any_manifest_is_read_or_refused(tmp_path, rows, more):
    path = tmp_path / "m.csv"
    path.write_bytes(b"log,name" + "\n".join(["", *rows]).encode() + more)
    try:
        entries = find_logs([str(path)])
    except InputError:
        return
    assert len({entry.name.casefold() for entry in entries}) == len(entries) > 0
