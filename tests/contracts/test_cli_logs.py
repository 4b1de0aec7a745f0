"""What is read of a log: its time, its scans, its topics, with or without odometry; and what run.json says of it."""

import json

import numpy as np
import pytest

from gridslam.io.bags.writer import write_bag
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_tum

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
