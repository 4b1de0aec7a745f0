"""A finished run is shown at any time of it as its files tell."""

from __future__ import annotations

import json
import shutil
import time

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.config import override
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import read_g2o
from gridslam.io.results.record import read_record
from gridslam.live.replay import Replay
from gridslam.slam.loop_closure.constraints import select_shown_closures
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("replay")
    write_carmen(folder / "loop.clf.gz", loop_drive().measurements[:330])
    configuration = override(PROVOKED, "when_to_resample.fraction=0.9", "particles=5")
    result = map_log(folder / "loop.clf.gz", configuration=configuration, repair="none")
    result.save(folder / "out")
    (folder / "out" / "caption").write_text(result.caption()[0])
    assert len(result.loop_summary.closures), "the drive was to close its loop"
    return folder / "out"


@pytest.fixture(scope="module")
def replay(out):
    return Replay(out)


@pytest.fixture(scope="module")
def record(out):
    return read_record(out / "record.npz")


def looking(replay):
    viewer, client = replay.add_viewer(lambda: None), PageClient()
    client.catch_up(viewer)
    return viewer, client


def test_any_time_can_be_looked_at_in_any_order(replay, record, out):
    viewer, client = looking(replay)
    places = read_g2o(out / "graph.g2o").graph.poses[:, :2].astype(np.float32)
    pairs = [pair["key_scans"] for pair in json.loads((out / "run.json").read_text())["loop_closure"]["closures"]]
    found = select_shown_closures(np.array(pairs), record.revisits)[:, 1]
    stamps_ns = np.append(record.stamps_ns[:-1], replay.trajectory(0).stamps_ns[-1])  # the last one ends with the log
    for at in (0, 50, 49, len(record) - 1, 7, 120):
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        assert client.status["at"] == at
        assert client.status["time_s"] == pytest.approx(1e-9 * (stamps_ns[at] - stamps_ns[0]))
        assert np.array_equal(client.path, places[: at + 1])
        particles = client.arrays["particles"]
        assert np.array_equal(particles[:, :3], record.poses[at])
        assert particles[:, 3].sum() == pytest.approx(1.0)
        assert len(client.arrays["closures"]) == sum(found <= at)
        assert client.status["closures"] == sum(end <= at for _, end in [*pairs, *record.revisits])
        for particle in range(5):
            assert client.past_of(particle)[-1] == pytest.approx(record.poses[at, particle, :2], abs=0.008)
            assert len(client.past_of(particle)) == at + 1
    viewer.command({"do": "seek", "at": 10**6})
    client.catch_up(viewer)
    assert client.status["at"] == len(record) - 1


def test_the_end_is_that_of_the_log(replay):
    """Scans that follow the last key scan are counted, and the robot is where it was last."""
    _, client = looking(replay)
    end = replay.trajectory(0)
    assert client.status["scans"] == len(end)
    assert client.status["pose"] == end.poses[-1].tolist()
    assert client.status["total_s"] == pytest.approx((end.stamps_ns[-1] - end.stamps_ns[0]) * 1e-9)
    assert client.series[-1, 0] == pytest.approx(client.status["total_s"])


def test_playing_goes_on_with_the_clock_and_stops_at_the_end(replay, record, monkeypatch):
    now = 100.0
    monkeypatch.setattr(time, "perf_counter", lambda: now)
    viewer, client = looking(replay)
    viewer.command({"do": "speed", "factor": 20})
    viewer.command({"do": "resume"})  # at the end: it begins anew
    client.receive(viewer.next_message())
    assert (client.status["at"], client.status["stage"]) == (0, "running")
    for passed in (0.5, 1.0, 2.0):
        now = 100.0 + passed
        client.receive(viewer.next_message())
        assert client.status["time_s"] == pytest.approx(20 * passed)
        at = client.status["at"]
        assert replay.results.times_s[at] <= 20 * passed < replay.results.times_s[at + 1]
    viewer.command({"do": "pause"})
    client.catch_up(viewer)
    now += 50
    assert viewer.next_message() is None
    viewer.command({"do": "resume"})
    now += 50
    client.receive(viewer.next_message())
    assert (client.status["at"], client.status["stage"]) == (len(record) - 1, "finished")


def broken(out, tmp_path, name, text):
    folder = tmp_path / "broken"
    shutil.copytree(out, folder)
    (folder / name).unlink()
    if text is not None:
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("run.json", None, "run.json: no such file; expected the folder"),
        ("run.json", "{", "expected JSON"),
        ("run.json", "[]", "expected a JSON object"),
        ("run.json", "{}", "gridslam map, localize, grid, landmarks, graph or merge wrote, got schema none"),
        ("run.json", json.dumps({"schema": "gridslam.doctor/3"}), "got schema gridslam.doctor"),
        ("record.npz", "nothing", "expected a record of a run"),
        ("map.yaml", None, "map.yaml"),
        ("trajectory.tum", "", "trajectory.tum"),
        ("graph.g2o", "VERTEX_SE2 0 0 0 0\n", "expected 1 key scans, got"),
    ],
)
def test_what_is_missing_or_does_not_belong_together_is_told(out, tmp_path, name, text, says):
    with pytest.raises(InputError, match=says):
        Replay(broken(out, tmp_path, name, text))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"closures": [{"stamps_ns": [1, 2]}]}, r"closures\[0\].key_scans: expected two key scans, got None"),
        ({"closures": [{"key_scans": [1, 2]}, {"key_scans": [1, "2"]}]}, r"closures\[1\].*got \[1, '2'\]"),
        ({"closures": [7]}, r"closures\[0\]"),
        ({"closures": 7}, "expected an object with a list of closures"),
        ([7], "expected an object with a list of closures"),
    ],
)
def test_closures_that_are_none_are_named(out, tmp_path, change, says):
    shutil.copytree(out, tmp_path / "out")
    document = json.loads((out / "run.json").read_text())
    (tmp_path / "out" / "run.json").write_text(json.dumps(document | {"loop_closure": change}))
    with pytest.raises(InputError, match=f"run.json: loop_closure.*{says}"):
        Replay(tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [("best", 999, "best: expected numbers from 0 to 4, got 999"), ("parents", -1, "parents: .* got -1"),
     ("poses", np.nan, "poses: .* got nan"), ("n_eff", -1.0, "n_eff")],
)  # fmt: skip
def test_records_of_what_no_run_does_are_refused(out, tmp_path, name, value, says):
    shutil.copytree(out, tmp_path / "out")
    arrays = dict(np.load(out / "record.npz").items())
    arrays[name].reshape(-1)[3] = value
    np.savez(tmp_path / "out" / "record.npz", **arrays)
    with pytest.raises(InputError, match=rf"record.npz: {says}"):
        Replay(tmp_path / "out")


def test_json_that_is_nested_without_end_and_an_origin_beyond_all_cells_are_refused(out, tmp_path):
    shutil.copytree(out, tmp_path / "out")
    (tmp_path / "out" / "run.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"run.json: expected JSON, got: values nested too deeply"):
        Replay(tmp_path / "out")
    shutil.copy(out / "run.json", tmp_path / "out")
    lines = (out / "map.yaml").read_text().splitlines()
    far = ["origin: [1e12, 0.0, 0.0]" if line.startswith("origin") else line for line in lines]
    (tmp_path / "out" / "map.yaml").write_text("\n".join(far))
    with pytest.raises(InputError, match=r"map.yaml, line \d: expected an origin within .* got \[1e\+12, 0\]"):
        Replay(tmp_path / "out")
