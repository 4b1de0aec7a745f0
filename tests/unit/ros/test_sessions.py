"""What a node leaves: of each session, whatever ends it, and of those of the node before."""

import pytest

from gridslam.io.csv import CsvLog
from gridslam.io.sessions.session_file import read_session
from support.node_faults import RunningNode, make_drive, run_fault


@pytest.fixture(scope="module")
def drive():
    return make_drive()[:80]


def test_a_node_that_is_started_again_keeps_the_record_of_the_one_before(drive, tmp_path):
    for scans in (30, 20, 10):
        node = RunningNode(record=str(tmp_path / "scans.csv"))
        node.play(drive[:scans])
        warnings = node.stop()
    assert "scans.csv is an earlier record: recording to" in warnings
    counts = {path.name: len(list(CsvLog(path))) for path in tmp_path.iterdir()}
    assert counts == {"scans.csv": 30, "scans-2.csv": 20, "scans-3.csv": 10}


def test_each_time_that_a_bag_is_played_is_a_drive_of_the_session(drive, tmp_path):
    node = RunningNode(out=str(tmp_path / "out"), record=str(tmp_path / "scans.csv"))
    for scans in (80, 60, 40):
        node.play(drive[:scans])
    node.stop()
    drives = read_session(tmp_path / "out" / "autosave.gridslam").drives
    scans = sorted(log.scans for drive in drives for log in drive.logs)
    assert scans == [39, 59, 80]  # without the first one, whose transform is that of the bag's end
    assert [path.name for path in tmp_path.glob("out*")] == ["out"]
    assert not list(tmp_path.glob("out/autosave-*"))
    counts = {path.name: len(list(CsvLog(path))) for path in tmp_path.glob("*.csv")}
    assert counts == dict(zip(("scans-3.csv", "scans-2.csv", "scans.csv"), scans, strict=True))


@pytest.mark.parametrize("name", ["proposal", "loop closure", "transport: map", "final refinement", "clock set back"])
def test_what_was_mapped_is_saved_whatever_fails(tmp_path, name):
    """Some of the faults of `tests/long/test_node_faults.py`."""
    found = run_fault(name, make_drive(), tmp_path, stays=True)
    assert found["error"] is None
    assert found["saved"] >= 49  # the last one may still be at work when the fault begins
