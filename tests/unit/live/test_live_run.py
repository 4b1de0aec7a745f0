"""What viewers have of a run is what the filter has, and the filter does not notice."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.errors import ArgumentError
from gridslam.live.control import Control
from gridslam.live.map_sight import MapSight
from gridslam.live.observer import LiveObserver
from gridslam.live.run import LiveRun
from gridslam.live.sight import CORRECTED
from gridslam.pipeline import run
from gridslam.scan import StoredScan
from support.loops import PROVOKED, loop_drive
from support.onlookers import Onlooker

RESAMPLING = override(PROVOKED, "when_to_resample.fraction=0.999")


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements


class Sight:
    """A run that is looked at without a server, every scan or as rarely as `every` says."""

    def __init__(self, every: int = 1) -> None:
        self.control = Control()
        self.live = LiveRun("loop", self.control, 30.0)
        self.observer = self.live.observer = LiveObserver(self.post, self.control, MapSight(30.0))
        self.every, self.scans, self.posted, self.held = every, 0, 0, []
        self.check = lambda state: None

    def post(self, snapshot):
        self.posted += 1
        self.live.apply(snapshot)
        self.observer.done()

    def __call__(self, report, state, seconds):
        self.scans += 1
        self.observer.period_s = 0.0 if self.scans % self.every == 0 else float("inf")
        self.observer._due = 0.0 if self.scans % self.every == 0 else float("inf")
        posted = self.posted
        self.observer(report, state, seconds)
        if self.posted > posted:
            self.check(state)

    def go(self, measurements, before=lambda report, state, seconds: None):
        slam, rng = build(RESAMPLING), np.random.default_rng(3)
        return run(self.observer.measured(measurements), slam, particles=6, rng=rng, observers=[before, self])


@pytest.mark.parametrize("every", [3, 11])
def test_two_viewers_see_the_best_map_at_every_time(drive, every):
    """One looks from the first scan on, one joins later; the past is resampled and corrected meanwhile."""
    sight, first, late = Sight(every), Onlooker(), Onlooker()
    viewers = [(first, sight.live.join(lambda: None))]

    def check(state):
        if sight.scans > 210 and len(viewers) == 1:
            viewers.append((late, sight.live.join(lambda: None)))
        for onlooker, viewer in viewers:
            onlooker.catch_up(viewer)
            assert onlooker.sees(state.maps.occupancy(state.best))
            assert onlooker.status["best"] == state.best
            for particle in range(6):
                past = state.ancestry.trajectory(particle)[:, :2]
                assert onlooker.past_of(particle) == pytest.approx(past, abs=0.008)

    sight.check = check
    sight.go(drive)
    assert len(first.series) == first.status["keys"]
    assert np.array_equal(first.series, late.series)
    assert (first.series[:, 3].astype(int) & CORRECTED).any(), "the drive was to correct the past"
    assert len(first.arrays["closures"]) == first.status["closures"] > 0


def test_the_filter_gives_the_same_bytes_with_and_without(drive):
    slam, rng = build(RESAMPLING), np.random.default_rng(3)
    alone = run(drive[:150], slam, particles=6, rng=rng).to_arrays()
    sight = Sight()
    viewer = sight.live.join(lambda: None)

    def check(state):
        if sight.scans == 20:
            viewer.command({"do": "watch", "particle": 0})
        viewer.message()

    sight.check = check
    watched = sight.go(drive[:150]).to_arrays()
    assert alone.keys() == watched.keys()
    for name, array in alone.items():
        assert array.tobytes() == watched[name].tobytes(), name


def test_a_chosen_particle_is_followed_until_its_line_dies_out(drive):
    sight, onlooker = Sight(), Onlooker()
    viewer, rows, seen = sight.live.join(lambda: None), {}, []

    def note(report, state, seconds):
        if report.parents is not None and "line" in rows:
            rows["line"] = [child for child in range(6) if report.parents[child] in rows["line"]]

    def check(state):
        onlooker.catch_up(viewer)
        if sight.scans == 5:
            viewer.command({"do": "watch", "particle": 4})
            rows["line"] = [4]
        elif rows:
            row = (rows["line"] or [-1])[0]
            assert onlooker.status["watched"] == row
            if row >= 0:
                assert onlooker.sees(state.maps.occupancy(row))
            seen.append(row)

    sight.check = check
    sight.go(drive[:150], before=note)
    assert seen[0] == 4
    assert len(set(seen)) > 1, "something was to be resampled"
    viewer.command({"do": "watch", "particle": None})
    onlooker.catch_up(viewer)
    assert onlooker.status["watched"] is None


def test_a_choice_made_before_a_resampling_means_the_particle_that_was_seen(drive):
    """The viewer chose what it saw before the last two resamplings."""
    sight, told = Sight(), []

    def note(report, state, seconds):
        if report.parents is not None:
            told.append((state.ancestry.steps, report.parents))

    slam, rng = build(RESAMPLING), np.random.default_rng(3)
    run(sight.observer.measured(drive[:150]), slam, particles=6, rng=rng, observers=[sight, note])
    seen = told[-2][0] - 1
    for particle in range(6):
        row = next((k for k in range(6) if told[-2][1][told[-1][1][k]] == particle), -1)
        sight.observer.watch(7, particle, seen)
        sight.observer._take(0.0)
        assert sight.live._rows[7] == row


def test_a_slow_reader_gets_fewer_snapshots_and_all_that_changed(drive):
    """While a snapshot is not done with none is taken, and nothing waits; the next brings all."""
    sight, onlooker, late = Sight(), Onlooker(), []
    viewer = sight.live.join(lambda: None)

    def post(snapshot):
        sight.posted += 1
        late.append(snapshot)

    def finish(report, state, seconds):
        sight(report, state, seconds)
        if late and sight.scans % 10 == 0:
            sight.live.apply(late.pop())
            sight.observer.done()

    sight.observer._post = post
    slam, rng = build(RESAMPLING), np.random.default_rng(3)
    state = run(drive[:120], slam, particles=6, rng=rng, observers=[finish])
    assert sight.posted <= 13
    for snapshot in late:
        sight.live.apply(snapshot)
    sight.observer.done()
    sight.observer._take(0.0)
    for snapshot in late[-1:]:
        sight.live.apply(snapshot)
    onlooker.catch_up(viewer)
    assert onlooker.sees(state.maps.occupancy(state.best))
    assert onlooker.status["scans"] == 120
    assert len(onlooker.series) == onlooker.status["keys"]


def test_final_refinement_replaces_what_was_seen(drive):
    sight, onlooker = Sight(every=20), Onlooker()
    viewer = sight.live.join(lambda: None)
    state = sight.go(drive[:100])
    viewer.command({"do": "watch", "particle": 2})
    onlooker.catch_up(viewer)
    other = build(RESAMPLING).mapper.empty(1)
    poses = state.ancestry.trajectory(0)
    far = np.array([[9.0, 9.0, 0.0]])
    other.update(np.zeros(1, np.int32), far, StoredScan(np.array([[1.0, 1.0]]), np.zeros(2)))
    sight.live.finish(other.occupancy(0), poses + 1.0, np.array([[0.0, 0.0, 1.0, 1.0]]))
    onlooker.catch_up(viewer)
    assert onlooker.sees(other.occupancy(0))
    assert onlooker.status["stage"] == "writing"
    assert np.array_equal(onlooker.path, (poses[:, :2] + 1.0).astype(np.float32))
    assert onlooker.arrays["closures"].tolist() == [[0, 0, 1, 1]]


def test_what_cannot_be_asked_is_refused(drive):
    sight = Sight()
    viewer = sight.live.join(lambda: None)
    with pytest.raises(ArgumentError, match="below 0"):
        viewer.command({"do": "watch", "particle": 0})
    sight.go(drive[:10])
    for command in ({"do": "fly"}, {"do": "watch", "particle": 6}, {"do": "speed", "times": 0}):
        with pytest.raises(ArgumentError):
            viewer.command(command)
    with pytest.raises(KeyError):
        viewer.command({"what": "pause"})
    viewers = [sight.live.join(lambda: None) for _ in range(9)]
    for other in viewers[:8]:
        other.command({"do": "watch", "particle": 1})
    with pytest.raises(ArgumentError, match="at most 8"):
        viewers[8].command({"do": "watch", "particle": 1})
    for other in viewers:
        other.close()
    viewer.command({"do": "watch", "particle": 1})
    assert sight.live.viewers == 1


def test_a_map_can_be_taken_exactly_as_it_is(drive):
    sight = Sight()
    state = sight.go(drive[:60])
    got, has = sight.live.map_of(0), state.maps.occupancy(state.best)
    ends = zip(has.origin[::-1], got.origin[::-1], strict=True)
    rows, columns = (slice(round(b / 0.05) - round(a / 0.05), None) for a, b in ends)
    cut = has.log_odds[rows, columns][: got.known.shape[0], : got.known.shape[1]]
    assert np.array_equal(got.log_odds, cut)
    assert got.known.sum() == has.known.sum()
