"""A submap is found in a whole map, at any heading, however that map came about."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam.component_alignment import Alignment
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.map_search import MapSearch
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_matching import Submap
from support import hall

LAP = 95
"""Key scans of a lap in the hall."""
ELSEWHERE = np.array([7.0, -3.0, 2.5])
"""Where the second drive has its origin, seen from the first one's."""
NOWHERE = np.empty((0, 3)), np.empty((0, 2))
"""What a search returns that finds no place."""


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(1))


def drive(seen, first, last, frame, gap=-1, step=1):
    """Every `step`-th key scan from `first` to `last` - 1 as tracked from another origin, blindly to the `gap`-th."""
    closure_state = LoopClosureState()
    poses = compose(between(frame, np.zeros(3)), seen.truth[first:last:step])
    for k, pose in enumerate(poses):
        closure_state.scans.append(seen.beams[first + step * k], pose, is_key=True)
        closure_state.graph.extend(pose, pose, (2.0, 1.0) if k == gap else DriftModel().variances(0.4, 0.1))
    return closure_state


def lap(seen):
    state = drive(seen, 0, LAP, np.zeros(3))
    return MapPiece(state.scans, state.graph)


def locator(pieces, begin=None):
    return EarlierPieces(pieces, hall.MAPPER, PlaceMatching(), begin=begin)


def found_after(earlier, closure_state):
    """The key scan at which a drive is found, and what; None if it is not."""
    for count in range(1, len(closure_state.graph) + 1):
        graph = closure_state.graph.snapshot()
        graph.truncate(count)
        found = earlier.locate(LoopClosureState(scans=closure_state.scans, graph=graph))
        if found is not None:
            return count - 1, found
    return None


def missed(found, seen, first):
    """Errors (m, rad) of the poses of a drive that began with key scan `first`."""
    errors = between(seen.truth[first : first + len(found.match.poses)], found.match.poses)
    return np.hypot(*errors[:, :2].T).max(), np.abs(errors[:, 2]).max()


def test_submaps_of_a_later_drive_are_found_in_a_map(seen):
    search = MapSearch(lap(seen).build_map(hall.MAPPER))
    later = drive(seen, LAP, 2 * LAP - 5, ELSEWHERE)
    hits = []
    for newest in range(30, LAP - 5, 5):
        submap = Submap.of(later.graph, newest - 15, np.arange(newest - 30, newest), later.scans, hall.MAPPER)
        true = seen.truth[LAP + newest - 15]
        errors = [between(true, pose) for pose in search(submap)[0]]
        hits.append(any(np.hypot(x, y) < 0.1 and abs(turn) < 0.02 for x, y, turn in errors))
        elsewhere = compose(true, [12.0, 0.0, 0.0])
        assert all(np.hypot(*(pose - elsewhere)[:2]) < 7.0 for pose in search(submap, elsewhere, 5.0, 0.5)[0])
    assert len(hits) >= 10
    assert np.mean(hits) >= 0.8


@pytest.mark.parametrize("first", [LAP, LAP + 30, LAP + 60])
def test_a_drive_is_found_where_it_is(seen, first):
    later = drive(seen, first, len(seen.truth), ELSEWHERE)
    key, found = found_after(locator([lap(seen)]), later)
    assert key <= 40
    metres, radians = missed(found, seen, first)
    assert metres < 0.1
    assert radians < 0.02
    assert any(constraint.determined for constraint in found.match.constraints)


def test_another_building_is_not_found(seen):
    other = hall.key_scans(hall.drive(3))
    later = drive(other, 0, LAP, ELSEWHERE)
    earlier = locator([lap(seen)])
    assert found_after(earlier, later) is None
    assert earlier.locate_whole(later) is None


def test_of_several_pieces_the_right_one_is_found(seen):
    other = hall.key_scans(hall.drive(3))
    _, found = found_after(locator([lap(other), lap(seen)]), drive(seen, LAP, len(seen.truth), ELSEWHERE))
    assert found.number == 1
    assert missed(found, seen, LAP)[0] < 0.1


def test_a_pose_that_is_known_bounds_the_search(seen):
    later = drive(seen, LAP, len(seen.truth), ELSEWHERE)
    begin = compose(seen.truth[LAP], [2.0, -1.0, 0.2])
    assert missed(found_after(locator([lap(seen)], begin), later)[1], seen, LAP)[0] < 0.1
    assert found_after(locator([lap(seen)], compose(begin, [10.0, 0.0, 0.0])), later) is None


@pytest.mark.parametrize("step", [1, 2, 3])
def test_the_search_begins_after_as_many_metres_however_dense_key_scans_are(seen, monkeypatch, step):
    searched = []
    monkeypatch.setattr(MapSearch, "__call__", lambda *_: searched.append(1) or NOWHERE)
    later = drive(seen, LAP, len(seen.truth), ELSEWHERE, step=step)
    way = later.graph.driven_m()
    earlier = locator([lap(seen)])
    for count in range(1, len(way) + 1):
        graph = later.graph.snapshot()
        graph.truncate(count)
        earlier.locate(LoopClosureState(scans=later.scans, graph=graph))
        assert bool(searched) == (way[count - 1] >= 5.0)
    assert len(searched) >= 3


def test_a_drive_that_is_resumed_is_found_at_the_same_key_scan(seen):
    """What was searched before is done again where it is needed: of a share of the work nothing is left out."""
    later = drive(seen, LAP, len(seen.truth), ELSEWHERE)
    key, found = found_after(locator([lap(seen)]), later)
    for steps in ([key], [key - 1, key], [key - 1, key - 1, key, key], [key, 20, key]):
        earlier = locator([lap(seen)])
        for newest in steps:
            graph = later.graph.snapshot()
            graph.truncate(newest + 1)
            again = earlier.locate(LoopClosureState(scans=later.scans, graph=graph))
        assert again.match.poses.tobytes() == found.match.poses.tobytes()


def test_no_key_scan_does_more_than_a_share_of_the_work(seen, monkeypatch):
    work = []
    for kind, name in ((MapSearch, "__call__"), (Alignment, "lay_component"), (Alignment, "decide")):
        method = getattr(kind, name)

        def count(*args, method=method, name=name):
            work.append(name)
            return method(*args)

        monkeypatch.setattr(kind, name, count)
    monkeypatch.setattr(Alignment, "decide", lambda *_: work.append("decide"))
    earlier, later = locator([lap(seen)] * 3), drive(seen, LAP, len(seen.truth), ELSEWHERE)
    shares = []
    for keys in range(1, len(later.graph) + 1):
        graph = later.graph.snapshot()
        graph.truncate(keys)
        work.clear()
        earlier.locate(LoopClosureState(scans=later.scans, graph=graph))
        shares.append(sorted(work))
    allowed = ([], ["__call__"], ["lay_component"], ["lay_component"] * 2, ["decide"])
    assert all(share in allowed for share in shares)
    assert ["decide"] in shares


def test_what_was_seen_before_a_gap_is_not_searched_for(seen):
    """After a blind stretch a drive is found by what it sees since, and where that is."""
    later = drive(seen, LAP, len(seen.truth), ELSEWHERE, gap=40)
    graph = later.graph
    graph.tracked[40:] = list(compose(ELSEWHERE, np.array(graph.tracked[40:])))  # nothing is known of the way there
    found = locator([lap(seen)]).align(later, 0, np.arange(40, len(graph)))
    assert np.hypot(*between(seen.truth[LAP + 40 :], found.match.poses[40:])[:, :2].T).max() < 0.1
