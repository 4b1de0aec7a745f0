"""What is read of a log: its time, its scans, its topics, with or without odometry; and what run.json says of it."""

from __future__ import annotations

import json
from itertools import islice

import numpy as np
import pytest

from gridslam.api.conversion import convert_log
from gridslam.errors import ArgumentError
from gridslam.io.bags.writer import write_bag
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.log import LogOptions, open_log
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_tum
from gridslam.types import BeamStatus
from support.refusals import refused

QUICK = "--particles", "1", "--no-loop-closure", "--json"


@pytest.fixture(scope="module")
def bag(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "rooms"
    write_bag(path, CarmenLog(log))
    return path


def test_map_takes_a_part_of_a_log_and_run_json_tells_which(log, tmp_path, call):
    options = "--start", "2", "--duration", "10.5", "--every", "3"
    status, out, err = call("map", log, "-o", tmp_path / "out", *options, *QUICK)
    assert (status, err) == (0, "")
    run = json.loads(out)
    stamps = np.array([m.scan.stamp_ns for m in CarmenLog(log)])
    since_s = (stamps - stamps[0]) * 1e-9
    chosen = stamps[(since_s >= 2) & (since_s < 12.5)][::3]
    assert read_tum(tmp_path / "out" / "trajectory.tum").stamps_ns.tolist() == chosen.tolist()
    assert run["input"]["selection"] == {"start_s": 2.0, "duration_s": 10.5, "every": 3}
    assert run["scans"]["read"] == len(chosen) == run["scans"]["used"] + sum(run["scans"]["skipped"].values())
    assert run["input"]["duration_s"] == (chosen[-1] - chosen[0]) / 1e9


def test_run_json_tells_what_a_bag_is_read_from(bag, tmp_path, call):
    options = "--scan", "/scan", "--odom", "/odom", "--base-frame", "base_link"
    status, out, err = call("map", bag, "-o", tmp_path / "out", *options, *QUICK)
    assert (status, err) == (0, "")
    told = json.loads(out)["input"]
    assert told["path"] == str(bag)
    assert told["sha256"] == compute_digest(bag)
    assert told["bytes"] > 0
    assert (told["odometry"], told["without_odometry"], told["selection"]) == ("/odom", 0, {})
    assert set(told["sensors"]) == {"/scan"}
    assert told["sensors"]["/scan"]["base_from_laser"] == pytest.approx([0.1, 0, 0])
    assert told["sensors"]["/scan"]["moved"] == 0


def test_a_log_that_has_no_odometry_maps_like_one_whose_odometry_is_left_out(log, tmp_path, call):
    call("convert", log, tmp_path / "none.csv", "--no-odometry")
    for path, options in ((log, ["--no-odometry"]), (tmp_path / "none.csv", [])):
        assert call("map", path, "-o", tmp_path / path.stem, *options, *QUICK)[0] == 0
    for name in ("map.pgm", "trajectory.tum"):
        assert (tmp_path / log.stem / name).read_bytes() == (tmp_path / "none" / name).read_bytes()


@pytest.mark.parametrize("command", ["map", "doctor", "convert"])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--start", "-1"], "--start: expected a time >= 0 s, got -1.0"),
        (["--start", "nan"], "'--start': expected a finite number, got nan"),
        (["--duration", "0"], "--duration: expected a time > 0 s, got 0.0"),
        (["--every", "0"], "0 is not in the range x>=1"),
        (["--start", "60"], "expected scans 60 s or more after the first: the log lasts 23.8 s"),
        (["--odom", "/odom"], "topics and frames are chosen in bags alone, and this is a CARMEN log"),
        (["--odom-frame", "odom"], "topics and frames are chosen in bags alone"),
        (["--scan", "rear"], "expected scans of rear, got scans of front alone"),
    ],
)
def test_options_that_cannot_be_are_refused_by_all_commands(log, tmp_path, call, command, options, message):
    out = [] if command == "doctor" else [tmp_path / "x.csv"] if command == "convert" else ["-o", tmp_path / "x"]
    status, told, err = call(command, log, *out, *options)
    assert (status, told) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def check_same(path, log, ranges_within: float) -> None:
    """The same scans, statuses, odometry and stamps; ranges within a relative difference."""
    read, written = list(open_log(path)), list(open_log(log))
    assert [m.scan.stamp_ns for m in read] == [m.scan.stamp_ns for m in written]
    for (odometry, scan), (known, true) in zip(read, written, strict=True):
        np.testing.assert_allclose(odometry.pose, known.pose, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(scan.status, true.status)
        hit = true.status == BeamStatus.HIT
        np.testing.assert_allclose(scan.ranges[hit], true.ranges[hit], rtol=ranges_within, atol=0)
        np.testing.assert_allclose(scan.geometry.directions, true.geometry.directions, rtol=0, atol=1e-6)
        np.testing.assert_allclose(scan.geometry.origin, true.geometry.origin, rtol=0, atol=1e-12)


def test_to_csv(log, tmp_path, call):
    status, out, err = call("convert", log, tmp_path / "log.csv.gz")
    assert (status, err) == (0, "")
    assert out == f"{log}: 120 scans, 24 s\n{tmp_path / 'log.csv.gz'}: 120 scans in the format csv\n"
    check_same(tmp_path / "log.csv.gz", log, 0)


@pytest.mark.parametrize(
    ("name", "form"), [("log.bag", "ros1"), ("log.mcap", "mcap"), ("log.db3", "ros2"), ("folder", "ros2")]
)
def test_to_bags_and_back(log, tmp_path, call, name, form):
    bag = tmp_path / "new" / name
    status, out, err = call("convert", log, bag)
    assert status == 0
    assert out.endswith(f"120 scans in the format {form}\n")
    assert err == ""
    assert [path.name for path in bag.parent.iterdir()] == [name]
    check_same(bag, log, 1e-7)  # single precision


def test_a_copy_maps_as_the_log_it_is_of(log, tmp_path, call):
    for name in ("log.csv", "log.bag"):
        assert call("convert", log, tmp_path / name)[0] == 0
    for source, out in ((log, "log"), (tmp_path / "log.csv", "csv"), (tmp_path / "log.bag", "bag")):
        assert call("map", source, "-o", tmp_path / out, "--particles", 1, "--no-loop-closure")[0] == 0
    files = ["map.pgm", "trajectory.tum", "trajectory_online.tum", "trajectory.csv"]
    assert [(tmp_path / "csv" / name).read_bytes() for name in files] == [
        (tmp_path / "log" / name).read_bytes() for name in files
    ]
    a, b = (read_tum(tmp_path / out / "trajectory.tum") for out in ("log", "bag"))
    assert a.stamps_ns.tolist() == b.stamps_ns.tolist()
    # Walls of simulated rooms lie on edges of cells: single precision decides to which side a hit falls.
    assert np.abs(a.poses - b.poses)[:, :2].max() < 0.05


def test_part_of_a_log_and_json(log, tmp_path, call):
    options = "--start", "4", "--duration", "10", "--every", "2", "--no-odometry", "--json"
    status, out, err = call("convert", log, tmp_path / "part.csv", *options)
    stamps = [m.scan.stamp_ns for m in CarmenLog(log)]
    chosen = [stamp for stamp in stamps if 4e9 <= stamp - stamps[0] < 14e9][::2]
    assert (status, err) == (0, "")
    assert json.loads(out) == {
        "schema": "gridslam.conversion/2",
        "log": str(log),
        "out": str(tmp_path / "part.csv"),
        "format": "csv",
        "scans": len(chosen),
        "written": len(chosen),
        "duration_s": (chosen[-1] - chosen[0]) / 1e9,
        "truncated": False,
    }
    read = list(open_log(tmp_path / "part.csv"))
    assert [m.scan.stamp_ns for m in read] == chosen
    assert {m.odometry for m in read} == {None}


@pytest.mark.parametrize(
    ("out", "options", "message"),
    [
        ("log.clf", [], "expected a name for a log, which ends in .csv"),
        (".", [], "got an existing folder"),
        ("there", [], "got an existing folder"),
        ("taken/log.csv", [], "taken is a file"),
        ("log.bag.gz", [], "expected a name for a log, which ends in .csv"),
        ("log.csv", ["--start", "1000"], "expected scans 1000 s or more after the first: the log lasts"),
        ("log.bag", ["--start", "1000"], "expected scans 1000 s or more after the first: the log lasts"),
        ("log.csv", ["--odom", "/odom"], "chosen in bags alone, and this is a CARMEN log"),
        ("log.csv", ["--scan", "rear"], "expected scans of rear, got scans of front alone"),
        ("log.csv", ["--duration", "0"], "--duration: expected a time > 0 s, got 0.0"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(log, tmp_path, call, out, options, message):
    (tmp_path / "there").mkdir()
    (tmp_path / "taken").write_text("")
    assert message in refused(call, tmp_path, "convert", log, tmp_path / out, *options)


def test_the_log_itself_is_no_place_for_its_copy(log, tmp_path, call):
    assert call("convert", log, tmp_path / "log.csv")[0] == 0
    (tmp_path / "link.csv").symlink_to(tmp_path / "log.csv")
    for name in ("log.csv", "link.csv"):
        assert "expected a name other than" in refused(call, tmp_path, "convert", tmp_path / "log.csv", tmp_path / name)
    with pytest.raises(ArgumentError, match="expected a name other than"):
        convert_log(tmp_path / "log.csv", tmp_path / "log.csv")


def test_in_python(log, tmp_path):
    done = convert_log(log, tmp_path / "log.csv", options=LogOptions(every=10))
    assert (done.out, done.format, done.scans) == (tmp_path / "log.csv", "csv", 12)
    parts = islice(CarmenLog(log), 0, None, 10)
    assert [m.scan.stamp_ns for m in open_log(done.out)] == [m.scan.stamp_ns for m in parts]
    with pytest.raises(ArgumentError, match="options"):
        convert_log(CarmenLog(log), tmp_path / "b.csv", options=LogOptions())
