"""What other commands than `map` left is shown as their files tell it."""

import json
import shutil

import numpy as np
import pytest

from gridslam.api.localization import BELIEF_HEADER, localize
from gridslam.cli.main import main
from gridslam.errors import InputError
from gridslam.geometry.se2 import between
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.maps import read_map, write_map
from gridslam.live.history import LOST
from gridslam.live.replay import Replay
from gridslam.messages import Messages
from gridslam.sim import OdometryNoise
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support.localization_world import drive, flat_map
from support.page_client import PageClient


def looking(replay):
    viewer, client = replay.add_viewer(lambda: None), PageClient()
    client.catch_up(viewer)
    return viewer, client


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A flat's map, a drive in it, and what localization said of that."""
    folder = tmp_path_factory.mktemp("flat")
    write_map(folder / "flat.yaml", flat_map())
    write_carmen(folder / "flat.clf", drive(1, OdometryNoise()).measurements)
    result = localize(folder / "flat.clf", folder / "flat.yaml", seed=2)
    result.save(folder / "out")
    return folder, result


def test_a_localization_is_shown_at_each_scan(place):
    folder, result = place
    viewer, client = looking(Replay(folder / "out"))
    assert client.sees(read_map(folder / "flat.yaml"))
    assert (client.run_info["title"], client.run_info["step"]) == ("flat.clf", "scan")
    assert set(client.run_info["layers"]) == {"map", "path", "n_eff", "lost_probability"}
    weighed = [report.n_eff for report in result.reports if report.skipped is None]
    told = client.series[~np.isnan(client.series[:, 1])]
    np.testing.assert_allclose(told[:, 1], weighed, atol=0.06)  # as written, one decimal
    assert (told[:, 1] <= told[:, 4]).all()
    np.testing.assert_array_equal(client.series[:, 3], LOST * result.lost)
    assert 0 < result.lost.sum() < len(result.lost)
    for at in (len(result.reports) // 2, 3, len(result.reports) - 1):
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        status, report = client.status, result.reports[at]
        np.testing.assert_allclose(status["pose"], report.pose, atol=1e-8)
        np.testing.assert_allclose(status["covariance"], report.covariance, rtol=1e-6, atol=1e-12)
        assert (status["lost"], status["particles"]) == (report.lost, report.particles)
        assert status["lost_probability"] == pytest.approx(report.lost_probability, abs=1e-5)
        assert status["inlier_ratio"] == pytest.approx(report.inlier_ratio, abs=1e-4)
        assert (status["scans"], len(client.path)) == (at + 1, at + 1)
        np.testing.assert_array_equal(np.isnan(client.path[:, 0]), result.lost[: at + 1])


def replace_parameters(out, tmp_path, name, text):
    folder = tmp_path / "changed"
    shutil.copytree(out, folder)
    (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("stamp_s,lost\n", "expected the columns stamp_s,lost,lost_probability"),
        (f"{BELIEF_HEADER}\n1,0,x,0,1,,0\n", "line 2: expected numbers"),
        (f"{BELIEF_HEADER}\n1,0\n", "expected seven numbers"),
        (f"{BELIEF_HEADER}\n1,0,0,0,1,,0\n", r"expected \d+ scans, got 1"),
    ],
)
def test_a_belief_that_is_none_is_told(place, tmp_path, text, says):
    with pytest.raises(InputError, match=says):
        Replay(replace_parameters(place[0] / "out", tmp_path, "belief.csv", text))


def test_a_graph_is_shown_with_the_edges_that_contradict_it_most(tmp_path, capsys):
    poses = np.zeros((20, 3))
    poses[:, 0] = np.arange(20.0)
    pairs = [(k, k + 1) for k in range(19)] + [(0, 10), (2, 15)]
    measured = between(poses[[a for a, _ in pairs]], poses[[b for _, b in pairs]])
    measured[-1] += 3.0  # a false one
    write_g2o(tmp_path / "in.g2o", PoseGraph.of(poses, pairs, measured, [np.eye(3)] * len(pairs)))
    assert main(["graph", str(tmp_path / "in.g2o"), "-o", str(tmp_path / "out")]) == 0
    _, client = looking(Replay(tmp_path / "out"))
    assert (client.run_info["title"], client.run_info["mode"]) == ("in.g2o", "still")
    assert set(client.run_info["layers"]) == {"path", "closures"}
    assert (client.status["poses"], client.status["edges"]) == (20, 21)
    (first, second, worst), (*_, other) = client.status["residuals"]
    assert (first, second) == (2, 15)
    assert worst > other
    found = read_g2o(tmp_path / "out" / "graph.g2o").graph
    np.testing.assert_allclose(client.path, found.poses[:, :2], atol=1e-5)
    np.testing.assert_allclose(client.arrays["closures"][0].reshape(2, 2), found.poses[[2, 15], :2], atol=1e-5)


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
