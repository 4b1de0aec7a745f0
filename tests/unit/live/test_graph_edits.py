"""A pose graph that is edited on the page: edges are rejected, it is solved again, and the edits stay."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.se2 import between
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.live.graph_edits import EDITED_GRAPH, EDITS, EditedGraph
from gridslam.live.replay import Replay
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support.page_client import PageClient

IDS = np.arange(20) + 100


@pytest.fixture
def folder(tmp_path):
    """A straight drive whose graph was solved with a false closure."""
    poses = np.zeros((20, 3))
    poses[:, 0] = np.arange(20.0)
    pairs = [(k, k + 1) for k in range(19)] + [(0, 10), (2, 15)]
    measured = between(poses[[a for a, _ in pairs]], poses[[b for _, b in pairs]])
    measured[-1, :2] += 3.0
    graph = PoseGraph.of(poses, pairs, measured, [np.eye(3)] * len(pairs))
    write_g2o(tmp_path / "graph.g2o", GraphSlam().solve(graph).graph, IDS)
    (tmp_path / "graph.json").write_text(json.dumps({"schema": "gridslam.graph/1", "input": {"path": "drive.g2o"}}))
    return tmp_path


def test_what_is_rejected_is_left_out_and_the_graph_is_solved_again(folder):
    before = (folder / "graph.g2o").read_bytes()
    edited = EditedGraph(folder)
    assert abs(edited.results.path[:, 1]).max() > 0.3, "bent by the false closure"
    edited.edit([2, 15])
    assert abs(edited.results.path[:, 1]).max() < 1e-6
    assert edited.results.status(0, 0.0)["chi2"] < 1e-9
    assert json.loads((folder / EDITS).read_text())["rejected"] == [[102, 115]]
    assert len(read_g2o(folder / EDITED_GRAPH).graph.edges) == 20
    assert (folder / "graph.g2o").read_bytes() == before
    again = EditedGraph(folder)
    np.testing.assert_array_equal(again.results.path, edited.results.path)
    again.edit([0, 10])
    assert again.results.status(0, 0.0)["rejected"] == [[2, 15], [0, 10]]
    again.edit(None)
    assert again.results.status(0, 0.0)["rejected"] == [[2, 15]], "the last one alone is taken back"
    again.edit(None)
    np.testing.assert_allclose(again.results.path, EditedGraph(folder).results.path)
    assert abs(again.results.path[:, 1]).max() > 0.3
    assert json.loads((folder / EDITS).read_text())["rejected"] == []


@pytest.mark.parametrize("wrong", [[0, 1], [2, 16], [2], "2,15", None, [15, 2], {}, [2.5, 15]])
def test_what_is_no_edge_to_reject_changes_nothing(folder, wrong):
    edited = EditedGraph(folder)
    with pytest.raises(ArgumentError, match="edit: expected"):
        edited.edit(wrong)
    assert not (folder / EDITS).exists()


@pytest.mark.parametrize(
    "text", ['{"rejected": [[1, 2]]}', '{"rejected": 3}', "{}", '{"rejected": [[102, "a"]]}', "[]"]
)
def test_edits_that_are_none_are_refused_in_a_line(folder, text):
    (folder / EDITS).write_text(text)
    with pytest.raises(InputError, match=EDITS):
        EditedGraph(folder)


def test_all_who_look_see_the_edits_and_only_where_they_are_allowed(folder):
    replay = Replay(folder, edits_graph=True)
    one, other = replay.add_viewer(lambda: None), replay.add_viewer(lambda: None)
    seen = PageClient()
    one.command({"do": "edit", "reject": [2, 15]})
    seen.catch_up(other)
    assert seen.run_info["edits_graph"]
    assert seen.status["rejected"] == [[2, 15]]
    assert abs(seen.path[:, 1]).max() < 1e-6
    one.command({"do": "edit", "reject": [0, 1]})
    client = PageClient()
    client.catch_up(one)
    assert "which is no odometry" in client.status["answer"]
    with pytest.raises(ArgumentError, match="view --edit-graph"):
        Replay(folder).add_viewer(lambda: None).command({"do": "edit", "reject": [2, 15]})
