"""What `localize` left is shown as its files tell it."""

import json

import numpy as np
import pytest

from gridslam.api.localization import localize
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.maps import read_map, write_map
from gridslam.live.history import LOST
from gridslam.live.history_file import HISTORY_NAME, write_history
from gridslam.live.recorder import RunRecorder
from gridslam.live.replay import Replay
from gridslam.messages import Messages
from gridslam.sim import OdometryNoise
from support.localization_world import drive, flat_map
from support.page_client import PageClient


def looking(replay):
    viewer, client = replay.add_viewer(), PageClient()
    client.catch_up(viewer)
    return viewer, client


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A flat's map, a drive in it, and what localization said of that."""
    folder = tmp_path_factory.mktemp("flat")
    write_map(folder / "flat.yaml", flat_map())
    write_carmen(folder / "flat.clf", drive(1, OdometryNoise()).measurements)
    history = RunRecorder()
    result = localize(folder / "flat.clf", folder / "flat.yaml", seed=2, observers=[history], gate=history.follow)
    result.save(folder / "out")
    write_history(folder / "out" / HISTORY_NAME, history.history)
    return folder, result


def test_a_localization_is_shown_at_each_update(place):
    folder, result = place
    viewer, client = looking(Replay(folder / "out"))
    assert client.sees(read_map(folder / "flat.yaml"))
    assert (client.run_info["title"], client.run_info["step"]) == ("flat.clf", "update")
    assert set(client.run_info["layers"]) == {"map", "path", "scan", "particles", "n_eff", "latency"}
    updates = [report for report in result.reports if report.skipped is None]
    np.testing.assert_allclose(client.series[:, 1], [report.n_eff for report in updates], rtol=1e-6)
    np.testing.assert_array_equal(client.series[:, 3], [LOST * report.lost for report in updates])
    np.testing.assert_allclose(client.path, [report.pose[:2] for report in updates], atol=1e-5)
    for at in (len(updates) // 2, 3, len(updates) - 1):
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        status, report = client.status, updates[at]
        assert (status["lost"], status["keys"]) == (report.lost, at + 1)
        assert client.sees(read_map(folder / "flat.yaml"))


def test_a_known_map_that_is_gone_is_said(place, tmp_path):
    _, result = place
    result.save(tmp_path / "out")
    path = tmp_path / "out" / "run.json"
    document = json.loads(path.read_text())
    document["input"]["map"] = str(tmp_path / "gone.yaml")
    path.write_text(json.dumps(document))
    _, client = looking(Replay(tmp_path / "out"))
    assert client.tiles == {}
    assert client.reported[0]["text"].startswith("without the map: ")


def test_the_messages_of_a_run_are_shown_again_and_checked(place, tmp_path):
    _, result = place
    messages = Messages(lambda level, text: None)
    messages("late scans", "by 2 s")
    result.save(tmp_path / "out", messages.to_list())
    _, client = looking(Replay(tmp_path / "out"))
    assert client.reported == messages.to_list()
    document = json.loads((tmp_path / "out" / "run.json").read_text())
    for wrong in ([{"level": "warning"}], {"level": 1}, [3]):
        (tmp_path / "out" / "run.json").write_text(json.dumps({**document, "messages": wrong}))
        with pytest.raises(InputError, match=r"run.json: messages: expected objects with level"):
            Replay(tmp_path / "out")
