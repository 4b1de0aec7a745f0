"""A running and a finished run are shown as they were at any time of them."""

from __future__ import annotations

import numpy as np
import pytest
from test_live_run import ObservedRun

from gridslam.api.mapping import map_log
from gridslam.config import override
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.maps import read_map
from gridslam.live.history_file import write_history
from gridslam.live.history_recorder import HistoryRecorder
from gridslam.live.replay import Replay
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements[:330]


@pytest.fixture(scope="module")
def mapped(drive, tmp_path_factory):
    """A finished run, and of each key scan the map, the path and the pose as they were."""
    folder, recorder, seen = tmp_path_factory.mktemp("past"), HistoryRecorder(30.0), []
    write_carmen(folder / "loop.clf.gz", drive)

    def note(report, state, seconds):
        if report.skipped is None:
            path = state.ancestry.trajectory(state.best)[:, :2]
            seen.append((state.maps.occupancy(state.best), path, np.array(report.pose)))

    configuration = override(PROVOKED, "when_to_resample.fraction=0.9", "particles=5")
    given = {"configuration": configuration, "repair": "none", "gate": recorder.follow, "observers": [recorder, note]}
    map_log(folder / "loop.clf.gz", **given).save(folder / "out")
    write_history(folder / "out" / "history.npz", recorder.history)
    return folder / "out", seen


def looking(replay):
    viewer, client = replay.add_viewer(lambda: None), PageClient()
    client.catch_up(viewer)
    return viewer, client


def test_a_finished_map_is_seen_as_it_was(mapped):
    out, seen = mapped
    viewer, client = looking(Replay(out))
    assert client.sees(read_map(out / "map.yaml")), "in the end the final map"
    assert "scan" in client.run_info["layers"]
    assert len(client.arrays["scan"]) == 0
    for at in (0, 60, 59, 120, len(seen) - 2, 7):
        grid, path, pose = seen[at]
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        assert client.sees(grid)
        assert client.path == pytest.approx(path, abs=1e-5)
        assert client.status["pose"] == pytest.approx(pose, abs=1e-5)
        assert client.status["scan_pose"] == pytest.approx(pose)
        assert len(client.arrays["scan"]) > 20
        on_path = {tuple(place) for place in client.path.tolist()}
        ends = client.arrays["closures"].reshape(-1, 2).tolist()
        assert all(tuple(end) in on_path for end in ends), "closures join places of the path as it was"
    viewer.command({"do": "seek", "at": 10**6})
    client.catch_up(viewer)
    assert client.sees(read_map(out / "map.yaml"))


def test_a_running_filter_is_seen_as_it_was_while_it_goes_on(drive):
    observed, client, now = ObservedRun(every=3), PageClient(), PageClient()
    viewer, other = (observed.live.add_viewer(lambda: None) for _ in range(2))
    seen = []

    def note(report, state, seconds):
        if report.skipped is None:
            path = state.ancestry.trajectory(state.best)[:, :2]
            seen.append((state.maps.occupancy(state.best), path, np.array(report.pose)))

    def check(state):
        now.catch_up(other)
        assert now.sees(state.maps.occupancy(state.best)), "whoever looks at the present is not disturbed"
        if observed.scans < 60:
            return
        at = (7 * observed.scans) % (len(seen) - 3)
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        grid, path, pose = seen[at]
        assert client.sees(grid)
        assert client.path == pytest.approx(path, abs=1e-5)
        assert client.status["pose"] == pytest.approx(pose)
        assert (client.status["at"], client.status["keys"]) == (at, at + 1)
        assert len(client.arrays["particles"]) == 6

    observed.check = check
    observed.go(drive[:250], before=note)
    viewer.command({"do": "seek", "at": 10**6})
    client.catch_up(viewer)
    assert client.sees(seen[-1][0])
    assert "at" not in client.status
