"""What `map --save` and `--continue`, `session` and `merge` write, print and return."""

import json
from dataclasses import replace

import pytest
from PIL import Image

from gridslam.api.session import Session
from gridslam.cli.main import main
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.sessions.drives import SavedPiece
from gridslam.io.sessions.session_file import write_session
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
    assert Replay(tmp_path / "out").last > 0


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
    assert Replay(tmp_path / "merged").run_info["layers"] == ("map", "path")
    drives = [drive["name"] for piece in document["pieces"] for drive in piece]
    assert sorted(drives) == ["monday", "tuesday"]
    assert (len(document["pieces"]) == 2) == ("apart, as nothing in common was found" in out)
    assert width_of(tmp_path / "merged" / "map.png") > 1000
    status, out, _ = call("session", tmp_path / "merged.gridslam")
    assert "the filter has ended" in out


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--same-place",), "--same-place needs --continue"),
        (("--pose", "0,0,0"), "--pose needs --continue"),
        (("--frozen",), "--frozen needs --continue"),
        (("--continue", "SESSION", "--particles", "9"), "--particles contradicts --continue"),
        (("--continue", "SESSION", "--seed", "9"), "--seed contradicts --continue"),
        (("--continue", "SESSION", "--same-place", "--elsewhere"), "--same-place contradicts --elsewhere"),
        (("--continue", "none.gridslam"), "none.gridslam"),
        (("--continue", "LOG"), "expected a session of gridslam"),
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


def test_the_maps_of_a_session_are_listed_and_written(call, monday, tmp_path):
    session = Session.open(monday)
    (piece,) = session.pieces
    other = SavedPiece(piece.piece, (replace(piece.drives[0], name="other"),))
    write_session(tmp_path / "both.gridslam", replace(session.saved, pieces=(other,)))
    status, out, err = call("session", tmp_path / "both.gridslam", "-o", tmp_path / "out")
    assert (status, err) == (0, "")
    assert "piece 1, monday: 1 drive" in out
    assert "piece 2, other: 1 drive" in out
    assert f"map: {tmp_path / 'out' / 'other.yaml'}" in out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {f"{name}{suffix}" for name in ("monday", "other") for suffix in (".yaml", ".pgm")}
