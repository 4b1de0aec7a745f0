"""A finished run is shown at any time of it as its files tell."""

import json
import shutil

import numpy as np
import pytest

from gridslam.config import override
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import read_g2o
from gridslam.io.maps import read_map
from gridslam.live.history_file import read_history
from gridslam.live.replay import Replay
from gridslam.slam.loop_closure.constraints import select_shown_closures
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient
from support.recorded import map_with_history


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("replay")
    write_carmen(folder / "loop.clf.gz", loop_drive().measurements[:330])
    configuration = override(PROVOKED, "when_to_resample.fraction=0.9", "particles=5")
    result = map_with_history(folder / "loop.clf.gz", folder / "out", configuration=configuration, repair="none")
    assert len(result.loop_summary.closures), "the drive was to close its loop"
    return folder / "out"


@pytest.fixture(scope="module")
def replay(out):
    return Replay(out)


@pytest.fixture(scope="module")
def history(out):
    return read_history(out / "history.npz")


def looking(replay):
    viewer, client = replay.add_viewer(), PageClient()
    client.catch_up(viewer)
    return viewer, client


def test_any_time_can_be_looked_at_in_any_order(replay, history):
    viewer, client = looking(replay)
    stamps_ns = np.array(history.stamps_ns)
    last = len(stamps_ns) - 1
    for at in (0, 50, 49, last, 7, 120):
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        assert client.status["at"] == at
        assert client.status["time_s"] == pytest.approx(1e-9 * (stamps_ns[at] - stamps_ns[0]))
        moment = history.moments[history.find(at + 1)]
        assert len(client.path) == (at + 1 if at == last else moment.keys)
        assert client.status["closures"] == sum(history.closures[:, 1] <= at)
        shown = select_shown_closures(history.closures[: history.recognized], history.closures[history.recognized :])
        assert len(client.arrays["closures"]) == sum(shown[:, 1] < len(client.path))
        if at < last:
            assert client.arrays["particles"][:, 3].sum() == pytest.approx(1.0)
    assert client.status["closures"] > 0
    viewer.command({"do": "seek", "at": 10**6})
    client.catch_up(viewer)
    assert client.status["at"] == last


def test_without_a_history_the_end_is_shown(out, tmp_path):
    shutil.copytree(out, tmp_path / "out")
    (tmp_path / "out" / "history.npz").unlink()
    _, client = looking(Replay(tmp_path / "out"))
    assert client.status["last"] == 0
    assert client.sees(read_map(out / "map.yaml"))
    assert client.path == pytest.approx(read_g2o(out / "graph.g2o").graph.poses[:, :2], abs=1e-4)


def test_the_end_is_the_final_map_and_path(out, replay, history):
    _, client = looking(replay)
    assert client.sees(read_map(out / "map.yaml"))
    poses = read_g2o(out / "graph.g2o").graph.poses
    assert client.path == pytest.approx(poses[:, :2], abs=1e-4)
    assert client.status["pose"] == pytest.approx(poses[-1].tolist())
    assert client.status["total_s"] == pytest.approx((history.stamps_ns[-1] - history.stamps_ns[0]) * 1e-9)


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
        ("run.json", "{}", "gridslam map, localize, grid or merge wrote, got schema none"),
        ("run.json", json.dumps({"schema": "gridslam.doctor/3"}), "got schema gridslam.doctor"),
        ("history.npz", "nothing", "expected a history of a run"),
        ("map.yaml", None, "map.yaml"),
        ("graph.g2o", "VERTEX_SE2 0 0 0 0\n", "expected at most 1 key scans, got"),
    ],
)
def test_what_is_missing_or_does_not_belong_together_is_told(out, tmp_path, name, text, says):
    with pytest.raises(InputError, match=says):
        Replay(broken(out, tmp_path, name, text))


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
