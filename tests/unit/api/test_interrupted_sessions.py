"""A run that goes on from earlier drives, killed before, while and after it is found: the same to the last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gridslam
from gridslam.api.autosave import Autosave
from gridslam.errors import InputError
from gridslam.io.csv import write_csv_log
from gridslam.io.log import open_log
from gridslam.io.maps import read_map, write_map
from gridslam.io.trajectories import read_tum
from gridslam.live.replay import Replay
from gridslam.tracking.tracker import Tracker
from support.interrupted import (
    CARRIED_AFTER,
    CARRIED_SCANS,
    CONFIG,
    SCANS,
    SCENARIOS,
    carry,
    drive,
    make_building,
    resume_after,
    run_node,
    run_whole,
)


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


def read_stamps(path):
    return np.array([scan.stamp_ns for _, scan in open_log(path)])


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_an_interrupted_run_is_found_again_and_gives_the_same_bytes(building, tmp_path, scenario):
    whole, found = run_whole(scenario, building, tmp_path / "whole")
    begins = (CARRIED_AFTER - 1, CARRIED_AFTER, CARRIED_AFTER + 1) if "carried" in scenario else ()
    last = CARRIED_SCANS if begins else SCANS
    assert 5 < found < last - 20
    for scan in (*begins, found - 1, found, found + 1, found + 2, (found + last) // 2, last):
        again = resume_after(scan, scenario, building, tmp_path / str(scan))
        assert again.keys() == whole.keys()
        assert [name for name in whole if again[name] != whole[name]] == [], scan


def test_a_node_that_goes_on_from_what_another_one_has_left_gives_the_same_bytes(building, tmp_path):
    """`serialize_map` and the autosave, before and after it was found: with another building as a piece apart."""
    whole = run_node(building, tmp_path / "whole")
    assert whole["found"]["drives"] == ("monday",)
    assert whole["apart"] == [["annex"]]
    for number, cuts in enumerate(([30], [150], [30, 90, 200])):
        for autosaved in (False, True):
            again = run_node(building, tmp_path / f"{number}{autosaved}", cuts, autosaved=autosaved)
            assert again.keys() == whole.keys()
            assert [name for name in whole if again[name] != whole[name]] == [], cuts


def test_a_log_in_which_the_robot_was_carried_gives_the_same_map_as_two_drives(building, tmp_path):
    told = []
    carried = gridslam.map_log(building / "carried.csv", configuration=CONFIG, on_finding=told.append)
    assert [finding.code for finding in told] == ["robot_carried"]
    session = gridslam.Session(CONFIG)
    measurements = list(open_log(building / "carried.csv"))
    for part in (measurements[:CARRIED_AFTER], measurements[CARRIED_AFTER:]):
        write_csv_log(tmp_path / "carried.csv", part)
        apart = session.add(tmp_path / "carried.csv", place="elsewhere" if session.saved.run else "auto")
    assert carried.trajectory.poses.tobytes() == apart.trajectory.poses.tobytes()
    assert carried.found_again == apart.found_again
    assert [drive.name for drive in carried.drives] == ["carried", "carried_2"]
    logs = [log for drive in carried.drives for log in drive.logs]
    assert [log.scans for log in logs] == [CARRIED_AFTER, CARRIED_SCANS - CARRIED_AFTER]
    assert sum(log.length_m for log in logs) == pytest.approx(carried.log.odometry_length_m)
    carried.save(tmp_path / "out")
    assert len(Replay(tmp_path / "out", None, 10.0).results.trajectory) == CARRIED_SCANS - CARRIED_AFTER
    statistics = carried.statistics
    assert statistics.key_scans + sum(statistics.skipped.values()) == carried.log.scan_count == CARRIED_SCANS


def test_a_carried_robot_that_sees_nothing_it_knows_leaves_two_pieces(building, tmp_path):
    write_csv_log(tmp_path / "log.csv", carry(drive()[:CARRIED_AFTER], drive("random")[:100]))
    result = gridslam.map_log(tmp_path / "log.csv", configuration=CONFIG, keep_particles=False)
    assert result.found_again is None
    assert [[drive.name for drive in piece.drives] for piece in result.pieces] == [["log"]]
    result.save(tmp_path / "out")
    own, apart = (len(read_tum(tmp_path / "out" / f"trajectory{name}.tum")) for name in ("", "_log"))
    assert (own, apart) == (100, CARRIED_AFTER)
    assert (tmp_path / "out" / "map_2.yaml").exists()


def test_without_loop_closure_nothing_is_begun_anew(building):
    result = gridslam.map_log(building / "carried.csv", configuration=replace(CONFIG, loop_closure=None))
    assert len(result.trajectory) == CARRIED_SCANS
    assert list(result.log.faults) == ["robot_carried (laser)"]
    assert result.pieces == ()


def test_a_resumed_run_reports_the_scans_that_had_failed_before(building, tmp_path, monkeypatch):
    step = Tracker.step
    stamps = read_stamps(building / "tuesday.csv")[[20, 30, 150]].tolist()

    def failing(self, state, odometry, stamp_ns, *others):
        if stamp_ns in stamps:
            raise RuntimeError("injected")
        return step(self, state, odometry, stamp_ns, *others)

    monkeypatch.setattr(Tracker, "step", failing)
    whole, _ = run_whole("continued", building, tmp_path / "whole")
    assert "3 scans failed and left out" in whole["failures"]
    again = resume_after(100, "continued", building, tmp_path / "again")
    assert [name for name in whole if again[name] != whole[name]] == []


def test_what_was_begun_in_one_map_does_not_go_on_in_another(building, tmp_path):
    """The same log and seed; of the given map alone the walls have changed."""
    (tmp_path / "other").mkdir()
    for name in ("known.yaml", "known.pgm", "tuesday.csv"):
        (tmp_path / "other" / name).write_bytes((building / name).read_bytes())
    resume_after(40, "prior", building, tmp_path / "out")
    grid = read_map(tmp_path / "other" / "known.yaml")
    rows, columns = np.nonzero(grid.log_odds > 1)
    grid.log_odds[rows[::20], columns[::20]] = 0.0
    write_map(tmp_path / "other" / "known.yaml", grid)
    autosave = Autosave(tmp_path / "out" / "autosave.gridslam", 3600.0)
    with pytest.raises(InputError, match="that of another run"):
        run_whole("prior", tmp_path / "other", tmp_path / "no", autosave=autosave)
