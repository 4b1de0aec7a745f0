"""What `gridslam graph` writes, prints and returns."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.geometry.se2 import between, compose
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.text import compute_digest
from gridslam.slam.pose_graph.descent import squared_mahalanobis
from gridslam.slam.pose_graph.pose_graph import PoseGraph

FILES = {"graph.g2o", "graph.png", "graph.json"}
FALSE = [(3, 31), (8, 39), (25, 49)]


@pytest.fixture
def call(call):
    return partial(call, "graph")


def _rounds(false=()):
    """A robot that goes three times around a circle of 20 poses, and sees where it was one and two rounds ago."""
    rng = np.random.default_rng(3)
    angle = np.arange(60) * np.pi / 10
    truth = np.stack([10 * np.cos(angle), 10 * np.sin(angle), angle], axis=1)
    edges = [(k, k + 1) for k in range(59)] + [(k, k + 20) for k in range(40)] + [(k, k + 40) for k in range(20)]
    pairs = np.array([*edges, *false])
    exact = between(truth[pairs[:, 0]], truth[pairs[:, 1]])
    exact[len(edges) :] = 0.0  # what is false says that two places are one
    measured = compose(exact, rng.normal(0, [0.05, 0.05, 0.01], exact.shape))
    poses = truth[:1].repeat(60, axis=0)
    for k in range(59):
        poses[k + 1] = compose(poses[k], measured[k])
    information = [np.diag([400.0, 400.0, 1e4])] * len(pairs)
    return truth, PoseGraph.of(poses, pairs, measured, information)


@pytest.fixture
def graph(tmp_path):
    """Path of the file and what is in it; its ids are the places plus 100."""
    path = tmp_path / "rounds.g2o"
    write_g2o(path, _rounds()[1], np.arange(100, 160))
    return path, read_g2o(path)


def test_files_and_figures(call, graph, tmp_path):
    path, source = graph
    out = tmp_path / "new" / "out"
    status, text, err = call(path, "-o", out)
    assert (status, err) == (0, "")
    assert {file.name for file in out.iterdir()} == FILES
    solved = read_g2o(out / "graph.g2o")
    document = json.loads((out / "graph.json").read_text())
    assert document["chi2_before"] == pytest.approx(source.graph.chi2())
    assert document["chi2_after"] == pytest.approx(solved.graph.chi2())
    assert f"chi2 {document['chi2_before']:.6g} before, {document['chi2_after']:.6g} after" in text
    # 3 (119 - 59) degrees of freedom: the least chi2 lies within 5 standard deviations of its mean, 180.
    assert abs(solved.graph.chi2() - 180) < 5 * np.sqrt(2 * 180)
    assert source.graph.chi2() > 2 * solved.graph.chi2()
    with Image.open(out / "graph.png") as picture:
        assert min(picture.size) > 1000


def test_json(call, graph, tmp_path):
    path, _ = graph
    status, text, err = call(path, "-o", tmp_path / "out", "--json", "--max-iterations", "50")
    assert (status, err) == (0, "")
    document = json.loads(text)
    assert document == json.loads((tmp_path / "out" / "graph.json").read_text())
    assert document["schema"] == "gridslam.graph/2"
    assert document["version"] == __version__
    assert document["input"] == {
        "path": str(path),
        "sha256": compute_digest(path),
        "vertices": 60,
        "edges": 119,
        "loop_closures": 60,
        "landmarks": 0,
        "fixed": 100,
        "skipped": {},
    }
    assert document["converged"] is True
    assert 0 < document["iterations"] <= 50
    assert (document["first_guess"], document["robust"], document["max_iterations"]) == ("either", False, 50)
    assert 0 < document["seconds"] == document["time"]["stages"]["solve"]["wall_s"] < 10
    assert "rejected" not in document


def test_without_a_guess_the_same_is_found(call, graph, tmp_path):
    path, source = graph
    call(path, "-o", tmp_path / "guess")
    nowhere = np.vstack([source.graph.poses[:1], np.zeros((59, 3))])
    write_g2o(tmp_path / "nowhere.g2o", source.graph.with_poses(nowhere), source.ids)
    for options in ([], ["--no-guess"]):
        status, text, _ = call(tmp_path / "nowhere.g2o", "-o", tmp_path / "none", "--json", *options)
        assert status == 0
        assert json.loads(text)["first_guess"] == ("computed" if options else "either")
        solved, expected = (read_g2o(tmp_path / name / "graph.g2o").graph.poses for name in ("none", "guess"))
        np.testing.assert_allclose(solved[:, :2], expected[:, :2], atol=1e-3)


def test_robust_finds_the_false_closures_and_the_truth(call, tmp_path):
    truth, graph = _rounds(FALSE)
    path, out = tmp_path / "false.g2o", tmp_path / "out"
    write_g2o(path, graph, np.arange(100, 160))
    status, text, _ = call(path, "-o", out, "--robust", "--json")
    assert status == 0
    document = json.loads(text)
    assert {file.name for file in out.iterdir()} == FILES
    assert document["rejected"] == [[a + 100, b + 100] for a, b in FALSE]
    assert [weight < 0.5 for weight in document["weights"]] == [k >= 119 for k in range(122)]
    solved = read_g2o(out / "graph.g2o")
    kept = squared_mahalanobis(solved.graph, solved.graph.errors()) @ document["weights"]
    assert document["chi2_after"] == pytest.approx(kept, rel=1e-4)
    # Half a metre is ten times a measurement's sigma; a false closure believed pulls by metres.
    assert np.hypot(*(solved.graph.poses - truth)[:, :2].T).max() < 0.5
    _, text, _ = call(path, "-o", out, "--robust")
    assert "rejected 3 loop closures: 103 131, 108 139, 125 149" in text


def test_unknown_tags(call, graph, tmp_path):
    path, _ = graph
    path.write_text(path.read_text() + "VERTEX_CAM 7 1 2\nVERTEX_CAM 8 1 2\nPARAMS\n")
    status, _, err = call(path, "-o", tmp_path / "out")
    assert status == 2
    assert err.startswith(f"gridslam: {path}, line 181: ")
    assert "--skip-unknown" in err
    status, text, _ = call(path, "-o", tmp_path / "out", "--skip-unknown")
    assert status == 0
    assert "skipped lines: 2 VERTEX_CAM, 1 PARAMS" in text
    document = json.loads((tmp_path / "out" / "graph.json").read_text())
    assert document["input"]["skipped"] == {"VERTEX_CAM": 2, "PARAMS": 1}


def test_the_three_lines_run(graph, tmp_path, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "graph_slam.md"
    text = page.read_text(encoding="utf-8")
    code = re.search(r"^<!-- graph -->\n```python\n(.*?)\n```$", text, re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    graph[0].rename("m3500.g2o.gz")  # plain text all the same: the first bytes tell
    names = {}
    exec(code[1], names)
    assert names["solution"].poses.shape == (60, 3)
    assert names["solution"].chi2_after < names["solution"].chi2_before
