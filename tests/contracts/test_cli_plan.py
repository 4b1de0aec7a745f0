"""What `gridslam plan` writes and reports, from a map and a run, and what it refuses."""

import json
import sys
from functools import partial

import pytest

from gridslam.cli.main import main
from gridslam.io.maps import write_map
from support.drawn_maps import draw_two_rooms

NAMES = {"plan.svg", "plan.geojson", "plan.json"}


@pytest.fixture
def call(call):
    return partial(call, "plan")


@pytest.fixture(scope="module")
def two_rooms(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "two_rooms.yaml"
    write_map(path, draw_two_rooms())
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The rooms world, its log, and the map and the folder of it."""
    folder = tmp_path_factory.mktemp("run")
    assert main(["simulate", "rooms", "-o", str(folder / "rooms.clf.gz"), "--beams", "90"]) == 0
    arguments = [
        "map",
        folder / "rooms.clf.gz",
        "-o",
        folder / "out",
        "--particles",
        "5",
    ]
    assert main([*map(str, arguments), "--no-history"]) == 0
    return folder


def test_a_map_alone_is_enough(call, two_rooms, tmp_path):
    status, out, err = call(two_rooms, "-o", tmp_path / "plan", "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert {file.name for file in (tmp_path / "plan").iterdir()} == NAMES
    assert json.loads((tmp_path / "plan" / "plan.json").read_text()) == document
    assert document["schema"] == "gridslam.plan/1"
    assert document["made_from"] == "cells"
    assert [room["name"] for room in document["rooms"]] == ["room 1", "room 2"]
    assert all(room["complete"] for room in document["rooms"])


def test_the_same_map_has_the_same_files(call, two_rooms, tmp_path):
    for name in ("a", "b"):
        call(two_rooms, "-o", tmp_path / name)
    assert all((tmp_path / "a" / n).read_bytes() == (tmp_path / "b" / n).read_bytes() for n in NAMES)


def test_a_run_is_planned_by_its_end_points(call, run, tmp_path):
    status, out, err = call(run / "out", "-o", tmp_path / "plan", "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert document["made_from"] == "end points"
    assert len(document["rooms"]) == 6
    widths = sorted(door["width_m"] for door in document["doors"])
    assert widths == pytest.approx([1.1, 1.1, 1.1, 1.1, 1.2, 1.2], abs=0.05)


def test_a_run_without_its_log_is_planned_by_its_cells(call, run, tmp_path):
    copied = tmp_path / "moved" / "out"
    copied.mkdir(parents=True)
    for name in ("map.yaml", "map.pgm", "trajectory.tum", "run.json"):
        (copied / name).write_bytes((run / "out" / name).read_bytes())
    document = json.loads((copied / "run.json").read_text())
    document["input"]["path"] = "elsewhere.clf.gz"
    (copied / "run.json").write_text(json.dumps(document))
    status, out, err = call(copied, "-o", tmp_path / "plan", "--json")
    assert status == 0
    assert err.count("\n") == 1
    assert "the log or the trajectory of this run is not there" in err
    assert json.loads(out)["made_from"] == "cells"


def test_a_log_that_is_another_one_is_not_taken(call, run, tmp_path):
    document = json.loads((run / "out" / "run.json").read_text())
    copied = tmp_path / "out"
    copied.mkdir()
    for name in ("map.yaml", "map.pgm", "trajectory.tum"):
        (copied / name).write_bytes((run / "out" / name).read_bytes())
    document["input"]["sha256"] = "0" * 64
    (copied / "run.json").write_text(json.dumps(document))
    assert json.loads(call(copied, "-o", tmp_path / "plan", "--json")[1])["made_from"] == "cells"


def test_a_bad_option_is_one_line(call, two_rooms, tmp_path):
    status, out, err = call(two_rooms, "-o", tmp_path / "plan", "--scale", "0")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--scale" in err
    assert not (tmp_path / "plan").exists()


@pytest.mark.parametrize("name", ["missing.yaml", "missing.gridslam", "empty", "free.yaml", "broken"])
def test_what_is_no_map_is_one_line(call, tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    write_map(tmp_path / "broken" / "map.yaml", draw_two_rooms())
    (tmp_path / "broken" / "run.json").write_text("{")
    grid = draw_two_rooms()
    write_map(tmp_path / "free.yaml", type(grid)(0 * grid.log_odds - 4, grid.known, 0.05, (0.0, 0.0)))
    status, out, err = call(tmp_path / name, "-o", tmp_path / "plan")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert name in err
    assert not (tmp_path / "plan").exists()


def test_without_the_extra_one_line_names_it(call, two_rooms, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    status, _, err = call(two_rooms, "-o", tmp_path / "plan")
    assert (status, err.count("\n")) == (1, 1)
    assert "pip install 'gridslam[map]'" in err
    assert not (tmp_path / "plan").exists()
