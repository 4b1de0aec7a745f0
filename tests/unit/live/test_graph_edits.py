"""A pose graph that is edited on the page: edges are rejected and added, it is solved again, and the edits stay."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.api.session import Session
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.sessions.session_file import read_session, write_session
from gridslam.live.graph_edits import EDITED_GRAPH, EditedGraph
from gridslam.live.replay import Replay
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.graph_edits import GraphEdit, dump_edits, load_edits
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """A loop that is closed, with its session, and the rest of its log."""
    folder = tmp_path_factory.mktemp("mapped")
    drive = loop_drive().measurements
    write_carmen(folder / "loop.clf.gz", drive[:300])
    write_carmen(folder / "rest.clf.gz", drive[300:])
    result = map_log(folder / "loop.clf.gz", configuration=PROVOKED, repair="none", keep_particles=True)
    result.save(folder / "out")
    Session.of(result.to_session()).save(folder / "loop.gridslam")
    return folder


@pytest.fixture
def session(mapped, tmp_path):
    """A copy of its session."""
    path = tmp_path / "loop.gridslam"
    path.write_bytes((mapped / "loop.gridslam").read_bytes())
    return path


def find_beside(edges, pair):
    """Edges within ten key scans of a pair."""
    return [edge for edge in np.sort(edges, axis=1).tolist() if np.abs(np.subtract(edge, pair)).max() < 10]


@pytest.mark.parametrize("wrong", [[0, 1], [2, 16], [2], "2,15", None, [15, 2], {}, [2.5, 15]])
def test_what_is_no_edge_to_reject_changes_nothing(mapped, session, wrong):
    before = session.read_bytes()
    edited = EditedGraph(mapped / "out", [session])
    with pytest.raises(ArgumentError, match="edit: expected"):
        edited.reject(wrong)
    assert session.read_bytes() == before


def test_all_who_look_see_the_edits_and_only_where_they_are_allowed(mapped, session, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(mapped / "out", out)
    shutil.copy(session, out / "loop.gridslam")
    before = (out / "graph.g2o").read_bytes()
    replay = Replay(out, edits_graph=True)
    one, other = replay.add_viewer(lambda: None), replay.add_viewer(lambda: None)
    pair = replay.results.status(0, 0.0)["residuals"][0][:2]
    seen = PageClient()
    one.command({"do": "edit", "edit": pair})
    seen.catch_up(other)
    assert seen.run_info["edits_graph"]
    assert seen.status["rejected"] == [sorted(pair)]
    assert (out / "graph.g2o").read_bytes() == before
    edited = read_g2o(out / EDITED_GRAPH).graph
    assert len(edited.edges) < len(read_g2o(out / "graph.g2o").graph.edges)
    np.testing.assert_allclose(seen.path, edited.poses[:, :2], atol=1e-3)
    one.command({"do": "edit", "edit": [0, 1]})
    client = PageClient()
    client.catch_up(one)
    assert client.status["answer"].startswith("nothing has changed: edit: expected two poses that an edge joins")
    with pytest.raises(ArgumentError, match="view --edit-graph"):
        Replay(out).add_viewer(lambda: None).command({"do": "edit", "edit": pair})


def test_the_last_edit_is_taken_back_alone(mapped, session):
    edited = EditedGraph(mapped / "out", [session])
    first, *_, second = (pair[:2] for pair in edited.results.status(0, 0.0)["residuals"])
    edited.reject(first)
    before = edited.results.path
    edited.reject(second)
    assert edited.results.status(0, 0.0)["rejected"] == [sorted(first), sorted(second)]
    again = EditedGraph(mapped / "out", [session])
    np.testing.assert_array_equal(again.results.path, edited.results.path)
    again.undo()
    assert again.results.status(0, 0.0)["rejected"] == [sorted(first)]
    np.testing.assert_array_equal(again.results.path, before)


def test_what_is_rejected_stays_so_however_the_session_goes_on(mapped, session, tmp_path):
    """What joins the same places goes with it, and nothing of it comes back: refined, continued or merged."""
    edited = EditedGraph(mapped / "out", [session])
    before = read_session(session).newest.graph
    pair = next(c.pair for c in before.constraints if c.source is ConstraintSource.RECOGNIZED)
    shown = np.array(edited.results.status(0, 0.0)["residuals"])[:, :2].astype(int)
    assert len(find_beside(shown, pair)) > 10
    edited.reject([*pair])
    left = np.array(edited.results.status(0, 0.0)["residuals"])[:, :2].astype(int)
    assert find_beside(left, pair) == []
    continued = Session.open(session)
    result = continued.add(mapped / "rest.clf.gz", repair="none", place="same place")
    assert find_beside(result.graph.edges, pair) == []
    continued.save(tmp_path / "continued.gridslam")
    again = Session.open(tmp_path / "continued.gridslam")
    assert find_beside(again.merge().graph.edges, pair) == []
    assert again.saved.newest.graph.rejected.tolist() == [[*pair]]
    EditedGraph(mapped / "out", [session]).undo()
    np.testing.assert_array_equal(read_session(session).newest.graph.poses, before.poses, "to the last bit")


def test_a_scan_is_put_on_another_place_and_holds_it_there(mapped, session):
    """What a person adds is matched near to where it was put, and never an outlier, however wrong it is."""
    edited = EditedGraph(mapped / "out", [session])
    poses = read_g2o(mapped / "out" / "graph.g2o").graph.poses
    key = len(poses) - 5
    here = poses[key, :2]
    assert edited.grab(here.tolist()).pair == (key, key)
    laid = edited.put(here.tolist(), (here + 0.2).tolist())
    assert laid.score > 0.9
    assert laid.pose[2] == pytest.approx(poses[key, 2], abs=0.03)
    assert len(laid.older) > 20 < len(laid.newer)
    assert edited.results.status(0, 0.0)["added"] == [], "looked at, and not added yet"
    before = read_session(session).newest.graph.poses
    wrong = laid.proposed._replace(measurement=laid.proposed.measurement + np.array([0.0, 2.0, 0.0]))
    edited.add(wrong)
    moved_m = np.hypot(*(edited.results.path[key] - poses[key, :2]))
    assert moved_m > 0.003, "pulled at, though surfaces that fit to a centimetre hold it"
    graph = read_session(session).newest.graph
    assert np.hypot(*(graph.poses[key] - before[key])[:2]) > 0.1, "made in the session, too"
    refined = Session.open(session).merge().graph
    assert list(wrong.pair) in refined.edges.tolist(), "and kept by the final refinement"
    with pytest.raises(ArgumentError, match="way at another time"):
        edited.put(here.tolist(), [500.0, 0.0])
    with pytest.raises(ArgumentError, match="one of"):
        edited.look(10**6)


def test_what_a_person_added_stays_when_what_joins_the_same_places_is_rejected(mapped, session, tmp_path):
    """It is shown and saved alike, also once the session has gone on, whose graph is then made with it."""
    edited = EditedGraph(mapped / "out", [session])
    made = read_session(session).newest.graph
    pair = next(c.pair for c in made.constraints if c.source is not ConstraintSource.PROXIMITY)
    beside = pair[0], pair[1] - 1
    added = Constraint(*beside, np.array([0.1, 0.2, 0.3]), np.eye(3), ConstraintSource.BY_HAND, True)
    edited.add(added)
    edited.reject([*pair])
    left = edited._now.graph
    assert find_beside(left.edges, pair) == [[*beside]]
    made = read_session(session).newest.graph
    assert find_beside(made.graph().edges, pair) == [[*beside]]

    (tmp_path / "later").mkdir()
    write_g2o(tmp_path / "later" / "graph.g2o", made.graph())
    saved = read_session(session)
    write_session(session, replace(saved, edits=()))  # as a run does that goes on: the graph has been edited
    later = EditedGraph(tmp_path / "later", [session])
    later.add(added._replace(to=beside[1] - 1))
    later.reject([beside[0], beside[1] - 1])
    assert find_beside(later._now.graph.edges, pair) == [[*beside]]
    assert find_beside(read_session(session).newest.graph.graph().edges, pair) == [[*beside]]
    later.reject([*beside])
    assert find_beside(later._now.graph.edges, pair) == []


def test_the_page_shows_both_scans_and_their_score(mapped, session, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(mapped / "out", out)
    shutil.copy(session, out / "loop.gridslam")
    replay = Replay(out, edits_graph=True)
    viewer, client = replay.add_viewer(lambda: None), PageClient()
    viewer.command({"do": "look", "edge": 0})
    client.catch_up(viewer)
    assert client.status["overlay"]["pair"] == client.status["residuals"][0][:2]
    assert 0.5 < client.status["overlay"]["score"] <= 1
    assert len(client.arrays["older"]) > 20 < len(client.arrays["scan"])
    poses = read_g2o(out / "graph.g2o").graph.poses
    viewer.command({"do": "grab", "at": poses[-5, :2].tolist()})
    viewer.command({"do": "put", "from": poses[-5, :2].tolist(), "to": poses[-5, :2].tolist()})
    viewer.command({"do": "edit", "edit": "add"})
    client.catch_up(viewer)
    assert len(client.status["added"]) == 1
    assert "overlay" not in client.status
    assert len(client.tiles) > 0, "the map as it is now"
    viewer.command({"do": "edit", "edit": "undo"})
    viewer.command({"do": "edit", "edit": "add"})
    client.catch_up(viewer)
    assert client.status["added"] == []
    assert "edit: expected" in client.status["answer"], "nothing is proposed"


def test_an_edit_that_cannot_be_saved_is_none(mapped, session, tmp_path, monkeypatch):
    """What the page shows is what is saved: else a reload would take it back."""

    def fail(path, saved):
        raise OutputError("no space left")

    shutil.copytree(mapped / "out", tmp_path / "out")
    edited = EditedGraph(tmp_path / "out", [session])
    (tmp_path / "out" / EDITED_GRAPH).unlink(missing_ok=True)
    before = edited.results
    monkeypatch.setattr("gridslam.live.graph_edits.write_session", fail)
    with pytest.raises(OutputError, match="no space left"):
        edited.reject(before.status(0, 0.0)["residuals"][0][:2])
    assert edited.results is before
    assert not (tmp_path / "out" / EDITED_GRAPH).exists(), "no program reads what was not saved"


def test_an_edit_whose_graph_cannot_be_written_is_none(mapped, session, tmp_path):
    shutil.copytree(mapped / "out", tmp_path / "out")
    edited = EditedGraph(tmp_path / "out", [session])
    (tmp_path / "out" / EDITED_GRAPH).unlink(missing_ok=True)
    (tmp_path / "out" / EDITED_GRAPH).mkdir()
    pair = edited.results.status(0, 0.0)["residuals"][0][:2]
    with pytest.raises(OutputError, match=EDITED_GRAPH):
        edited.reject(pair)
    assert read_session(session, makes_edits=False).edits == ()
    (tmp_path / "out" / EDITED_GRAPH).rmdir()
    edited.reject(pair)
    assert len(read_session(session, makes_edits=False).edits) == 1


def test_the_session_of_a_graph_is_the_first_that_has_its_key_scans(mapped, session):
    longer = session.with_name("longer.gridslam")
    continued = Session.open(session)
    continued.add(mapped / "rest.clf.gz", repair="none", place="same place")
    continued.save(longer)
    kept = longer.read_bytes()
    edited = EditedGraph(mapped / "out", [longer, session])
    edited.reject(edited.results.status(0, 0.0)["residuals"][0][:2])
    assert len(read_session(session, makes_edits=False).edits) == 1
    assert longer.read_bytes() == kept
    with pytest.raises(InputError, match="a session of its graph"):
        EditedGraph(mapped / "out", [longer])


def test_a_session_that_another_program_has_saved_since_is_not_overwritten(mapped, session):
    edited = EditedGraph(mapped / "out", [session])
    pair = edited.results.status(0, 0.0)["residuals"][0][:2]
    edited.reject(pair)
    edited.undo()
    written = replace(read_session(session), written="2020-01-01T00:00:00+00:00")
    write_session(session, written)
    now, shown = session.read_bytes(), edited.results
    with pytest.raises(InputError, match="another program has saved this session"):
        edited.reject(pair)
    assert session.read_bytes() == now
    assert edited.results is shown


@pytest.mark.parametrize(
    "edits",
    [
        3,
        [[1, 2]],
        [{"reject": [2, 1]}],
        [{"reject": [0, 10**6]}],
        [{"reject": [0, "a"]}],
        [{"add": [0, 9]}],
        [{"add": [0, 9], "measured": [0, 0, float("nan")], "information": np.eye(3).tolist()}],
        [{"add": [0, 9], "measured": [0, 0, 0], "information": (-np.eye(3)).tolist()}],
        [{"add": [0, 9], "measured": [0, 0, 1e300], "information": np.eye(3).tolist()}],
    ],
)
def test_edits_of_a_session_that_are_none_are_refused(edits):
    with pytest.raises(ArgumentError, match=r"edits|information|PoseGraph"):
        load_edits(edits, 50)


def test_edits_are_read_as_they_were_written():
    added = Constraint(3, 9, np.array([1.0, 2.0, 0.5]), np.diag([1.0, 2.0, 3.0]), ConstraintSource.BY_HAND, True)
    edits = (GraphEdit((1, 5)), GraphEdit((3, 9), added))
    read = load_edits(json.loads(json.dumps(dump_edits(edits))), 10)
    assert read[0] == edits[0]
    assert (read[1].pair, read[1].added.identity) == ((3, 9), added.identity)
    np.testing.assert_array_equal(read[1].added.information, added.information)
