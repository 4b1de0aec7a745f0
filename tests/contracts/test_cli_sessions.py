"""What `map --save` and `--continue`, `session` and `merge` write, print and return."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import gridslam
from gridslam.api.session_edits import find_edits
from gridslam.cli.live import _open_session_map
from gridslam.cli.main import main
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.edited_maps import anchor_edit, read_edited_map
from gridslam.io.edits import Edit, Edits, read_edits, write_edits
from gridslam.io.trajectories import read_tum
from gridslam.live.replay import Replay

FEW = "--particles", "3"


def width_of(path):
    with Image.open(path) as picture:
        return picture.size[0]


@pytest.fixture(scope="module")
def logs(simulated, tmp_path_factory):
    """Two logs, of which the second goes on where the first one ends."""
    folder = tmp_path_factory.mktemp("logs")
    for name, part in (("monday", slice(0, 150)), ("tuesday", slice(150, 300))):
        write_carmen(folder / f"{name}.clf", simulated.measurements[part])
    return folder


@pytest.fixture(scope="module")
def monday(logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("monday")
    session = folder / "rooms.gridslam"
    command = ["map", str(logs / "monday.clf"), "-o", str(folder / "out"), *FEW, "--save", str(session)]
    assert main(command) == 0
    return session


def test_a_session_goes_on(call, logs, monday, tmp_path):
    both = tmp_path / "both.gridslam"
    options = "--continue", monday, "--save", both
    status, out, err = call("map", logs / "tuesday.clf", "-o", tmp_path / "out", *options)
    assert (status, err) == (0, "")
    assert "tuesday.clf continues where the session ended: the first scan is" in out
    assert f"session: {both}" in out
    document = json.loads((tmp_path / "out" / "run.json").read_text())
    assert document["scans"]["read"] == 300
    (drive,) = document["session"]["drives"]
    assert [log["scans"] for log in drive["logs"]] == [150, 150]
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 300
    assert Replay(tmp_path / "out").results.missing == ""


def test_what_was_moved_stays_apart_or_is_found_and_merging_is_written(call, logs, monday, tmp_path):
    two = tmp_path / "two.gridslam"
    options = "--continue", monday, "--elsewhere", "--save", two, "--name", "robot2"
    status, out, _ = call("map", logs / "tuesday.clf", "-o", tmp_path / "out", *options)
    assert status == 0
    assert "tuesday.clf begins elsewhere (forced)" in out
    names = {path.name for path in (tmp_path / "out").iterdir()}
    found = "relocalized in the map of monday" in out
    assert found == ("trajectory_robot2.tum" in names) != ("map_2.yaml" in names)
    other = tmp_path / "other.gridslam"
    assert call("map", logs / "tuesday.clf", "-o", tmp_path / "b", *FEW, "--save", other)[0] == 0
    status, out, err = call("merge", monday, other, "-o", tmp_path / "merged", "--save", tmp_path / "merged.gridslam")
    document = json.loads((tmp_path / "merged" / "run.json").read_text())
    assert document["schema"] == "gridslam.merge/1"
    assert status == (not document["joined"]), err
    assert ("nothing was joined" in err) == (not document["joined"])
    written = {path.name for path in (tmp_path / "merged").glob("trajectory_*.tum")}
    assert written == {"trajectory_monday.tum", "trajectory_tuesday.tum"}, "of each drive, joined or not"
    assert Replay(tmp_path / "merged").results.layers == ("map", "path", "closures")
    drives = [drive["name"] for piece in document["pieces"] for drive in piece]
    assert sorted(drives) == ["monday", "tuesday"]
    assert (len(document["pieces"]) == 2) == ("apart, as nothing in common was found" in out)
    assert width_of(tmp_path / "merged" / "map.png") > 1000
    status, out, _ = call("session", tmp_path / "merged.gridslam")
    assert "the filter has ended" in out


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--same-place",), "--same-place needs --continue or --prior"),
        (("--pose", "0,0,0"), "--pose needs --continue or --prior"),
        (("--frozen",), "--frozen needs --continue or --prior"),
        (("--continue", "SESSION", "--particles", "9"), "--particles contradicts --continue"),
        (("--continue", "SESSION", "--seed", "9"), "--seed contradicts --continue"),
        (("--continue", "SESSION", "--same-place", "--elsewhere"), "--same-place contradicts --elsewhere"),
        (("--continue", "none.gridslam"), "none.gridslam"),
        (("--continue", "LOG"), "expected a session of gridslam"),
        (("--prior", "none.yaml"), "none.yaml"),
    ],
)
def test_what_contradicts_is_refused_and_nothing_is_written(call, logs, monday, tmp_path, options, problem):
    places = {"SESSION": monday, "LOG": logs / "monday.clf"}
    given = [places.get(option, option) for option in options]
    status, out, err = call("map", logs / "tuesday.clf", "-o", tmp_path / "out", *given)
    assert (status, out) == (2, "")
    assert problem in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (["SESSION"], "two or more files"),
        (["SESSION", "SESSION"], "each of them once"),
        (["SESSION", "none.gridslam"], "none.gridslam"),
    ],
)
def test_what_cannot_be_merged_is_refused(call, monday, tmp_path, given, problem):
    files = [monday if name == "SESSION" else name for name in given]
    status, _, err = call("merge", *files, "-o", tmp_path / "out")
    assert status == 2
    assert problem in err
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def floors(logs, monday, tmp_path_factory):
    """A session of two floors, with a lift on each and a zone on the upper one."""
    folder = tmp_path_factory.mktemp("floors")
    ground, both = folder / "ground.gridslam", folder / "both.gridslam"
    first = "map", logs / "monday.clf", "-o", folder / "a", *FEW, "--save", ground, "--floor", "ground"
    second = "map", logs / "tuesday.clf", "-o", folder / "b", "--continue", ground, "--save", both, "--floor", "upper"
    for arguments in (first, second):
        assert main([str(argument) for argument in arguments]) == 0
    session = gridslam.Session.open(both)
    edits = []
    for name, x in (("monday", 0.0), ("tuesday", 0.5)):
        start = session.trajectories[name].poses[0, :2]
        ends = start + np.array([[x, 0.0], [x, 1.0]])
        edits.append(anchor_edit(Edit("links", "LineString", ends, "Lift 1"), {name: session.trajectories[name]}))
    square = start + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    edits.append(Edit("keep_out", "Polygon", square))  # of the newest drive's map
    write_edits(folder / "both.edits.geojson", Edits(tuple(edits)))
    return both


def test_maps_of_floors_are_listed_with_their_links_and_written_with_their_edits(call, floors, tmp_path):
    status, out, err = call("session", floors, "-o", tmp_path / "out")
    assert (status, err.count("\n")) == (0, 1)
    assert "1 edit without a drive, taken for upper, the newest map" in err
    assert "piece 1, upper: 1 drive" in out
    assert "piece 2, ground: 1 drive" in out
    assert "3 edits" in out
    (link,) = (line for line in out.splitlines() if line.startswith("link Lift 1: ground "))
    assert "; upper " in link.replace(", upper", "; upper")
    document = json.loads(call("session", floors, "--json")[1])
    assert document["maps"] == ["upper", "ground"]
    assert [end["map"] for end in document["links"]["Lift 1"]] == ["ground", "upper"]
    assert document["links"]["Lift 1"][0]["pose"][2] == pytest.approx(math.pi / 2)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {f"{name}{suffix}" for name in ("ground", "upper") for suffix in (".yaml", ".pgm", ".geojson")}
    for name, layers in (("ground", ["links"]), ("upper", ["links", "keep_out"])):
        assert [edit.layer for edit in read_edits(tmp_path / "out" / f"{name}.geojson").edits] == layers
        assert read_edited_map(tmp_path / "out" / f"{name}.geojson").known.any()
    status, out, _ = call(
        "mask", tmp_path / "out" / "upper.yaml", tmp_path / "out" / "upper.geojson", "-o", tmp_path / "m"
    )
    assert (status, "keepout mask, 1.0 m²" in out) == (0, True)


def test_each_floor_has_a_plan_with_its_edits(call, floors, tmp_path):
    """What is erased on one floor has gone from its plan alone; rooms have the names that people gave."""
    for suffix in (".gridslam", ".edits.geojson"):
        shutil.copy(floors.with_suffix(suffix), tmp_path)
    path = tmp_path / floors.name
    session = gridslam.Session.open(path)
    plans = {}
    for name in ("ground", "upper", "erased"):
        floor = "upper" if name == "erased" else name
        if name == "erased":
            place = session.trajectories["tuesday"].poses[0, :2]
            square = place + np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
            edits = [Edit("erased", "Polygon", square, drive="tuesday")]
            write_edits(find_edits(path), Edits((*edits, Edit("rooms", "Point", place[None], "hall", drive="tuesday"))))
        status, _, err = call("plan", path, "--floor", floor, "-o", tmp_path / name)
        assert (status, err) == (0, "")
        plans[name] = json.loads((tmp_path / name / "plan.json").read_text())
    assert plans["ground"]["walls"] != plans["upper"]["walls"]
    assert plans["erased"]["walls_length_m"] < plans["upper"]["walls_length_m"] - 5.0
    assert "hall" in [room["name"] for room in plans["erased"]["rooms"]]
    assert "both, upper" in (tmp_path / "upper" / "plan.svg").read_text()
    for arguments, problem in (
        (("plan", path, "--floor", "cellar"), "--floor: expected upper or ground, got cellar"),
        (("changes", path, path, "--floor", "cellar"), "--floor: expected upper or ground, got cellar"),
        (("align", path, path, "--floor", "cellar"), "--floor: expected upper or ground, got cellar"),
        (("plan", tmp_path / "x.yaml", "--floor", "upper"), "--floor: expected a session"),
    ):
        status, out, err = call(*arguments, "-o", tmp_path / "none")
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert problem in err


def test_a_map_of_a_session_is_edited_and_those_of_other_floors_stay(floors, tmp_path):
    for suffix in (".gridslam", ".edits.geojson"):
        shutil.copy(floors.with_suffix(suffix), tmp_path)
    path = tmp_path / floors.name
    shown, edits = _open_session_map(path, "ground", edit=True)
    assert shown.grid.known.any()
    replay = Replay(path, None, 10.0, True, shown=shown)
    assert replay.run_info["mode"] == "still"
    assert "edits" in replay.run_info["layers"]
    text, tag = edits.read()
    (link,) = json.loads(text)["features"]
    assert link["properties"]["drive"] == "monday"
    edits.save(json.dumps(json.loads(text) | {"features": []}).encode(), tag)
    left = read_edits(find_edits(path))
    assert [(edit.layer, edit.drive) for edit in left.edits] == [("links", "tuesday"), ("keep_out", "")]
    text, tag = edits.read()
    write_edits(find_edits(path), Edits(left.edits[:1]))  # as a run does that goes on with the session
    with pytest.raises(InputError, match="a run that goes on, has saved edits since"):
        edits.save(text.encode(), tag)
    assert len(read_edits(find_edits(path)).edits) == 1


def test_a_floor_is_named_where_it_is_kept(call, logs, floors, tmp_path):
    for options, problem in (
        (("--floor", "ground"), "--floor needs --save or --continue"),
        (("--floor", "a/b", "--continue", floors), "expected 1 to 40 letters"),
    ):
        status, out, err = call("map", logs / "monday.clf", "-o", tmp_path / "out", *options)
        assert (status, out) == (2, "")
        assert problem in err
    assert "needs a folder OUT" in call("view", floors, "--edit-graph")[2]
    status, _, err = call("view", floors, "--floor", "cellar")
    assert (status, err.count("\n")) == (2, 1)
    assert "expected upper or ground, got cellar" in err


def test_a_log_at_the_same_place_is_on_the_same_floor(call, logs, floors, tmp_path):
    given = "--continue", floors, "--same-place", "--floor", "ground"
    status, out, err = call("map", logs / "tuesday.clf", "-o", tmp_path / "out", *given)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--floor: expected upper, on which the robot is at the same place, got ground" in err
    assert not list(tmp_path.iterdir())


def test_a_given_map_is_shown_and_not_edited(floors, tmp_path):
    session = gridslam.Session.open(floors)
    session.add_map(session.map)
    session.save(tmp_path / "known.gridslam")
    assert _open_session_map(tmp_path / "known.gridslam", "given", edit=False)[0].grid.known.any()
    with pytest.raises(InputError, match="to be edited, got the given map"):
        _open_session_map(tmp_path / "known.gridslam", "given", edit=True)


def test_edits_of_unknown_drives_are_left_out(call, floors, tmp_path):
    shutil.copy(floors, tmp_path)
    ends = np.array([[0.0, 0.0], [0.0, 1.0]])
    stray = Edit("links", "LineString", ends, "Lift 9", anchor=np.array([1.0, 0, 0, 0]), drive="sunday")
    write_edits(tmp_path / "both.edits.geojson", Edits((stray,)))
    status, out, err = call("session", tmp_path / floors.name, "--json")
    assert (status, err.count("\n")) == (0, 1)
    assert "1 edit of drives or scans that are not in this session, left out" in err
    assert (json.loads(out)["edits"], json.loads(out)["links"]) == (0, {})


def test_edits_without_a_scan_lie_on_the_map_of_their_drive(call, floors, tmp_path):
    """As another program writes them: one of a drive, one of a drive and one of a scan that are not there."""
    shutil.copy(floors, tmp_path)
    ends = np.array([[0.0, 0.0], [0.0, 1.0]])
    drawn = Edit("no_go", "LineString", ends, drive="monday")
    strays = replace(drawn, drive="sunday"), replace(drawn, drive="", anchor=np.array([12345.678, 0, 0, 0]))
    write_edits(tmp_path / "both.edits.geojson", Edits((drawn, *strays)))
    status, _, err = call("session", tmp_path / floors.name, "-o", tmp_path / "out")
    assert (status, err.count("\n")) == (0, 1)
    assert "2 edits of drives or scans that are not in this session, left out" in err
    assert [path.name for path in (tmp_path / "out").glob("*.geojson")] == ["ground.geojson"]
    (shown,) = read_edits(tmp_path / "out" / "ground.geojson").edits
    assert shown.drive == "monday"


def test_a_merge_names_which_maps_were_not_compared(call, logs, monday, tmp_path):
    upper = tmp_path / "upper.gridslam"
    given = "--save", upper, "--floor", "upper", *FEW
    assert call("map", logs / "tuesday.clf", "-o", tmp_path / "out", *given)[0] == 0
    status, _, err = call("merge", monday, upper, "-o", tmp_path / "merged")
    assert status == 1
    assert "nothing was joined: maps are compared within a floor" in err
    assert "on no floor" in err
