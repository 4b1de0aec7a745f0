"""What viewers have of a run is what the filter has, and the filter does not notice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.errors import ArgumentError
from gridslam.live.control import Control
from gridslam.live.history import CORRECTED
from gridslam.live.monitor import MappingMonitor
from gridslam.live.observer import LiveObserver
from gridslam.live.run import LiveRun
from gridslam.pipeline import run
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient

RESAMPLING = override(PROVOKED, "when_to_resample.fraction=0.999")


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements


class ObservedRun:
    """A run that is looked at without a server, every scan or as rarely as `every` says."""

    def __init__(self, every: int = 1) -> None:
        self.control = Control()
        self.live = LiveRun("loop", self.control, 30.0)
        self.observer = self.live.observer = LiveObserver(self.post, self.control, MappingMonitor())
        self.every, self.scans, self.posted, self.held = every, 0, 0, []
        self.check = lambda state: None

    def post(self, snapshot):
        self.posted += 1
        self.live.apply(snapshot)
        self.observer.release()

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
        return run(self.observer.pace(measurements), replace(slam, particles=6), rng=rng, observers=[before, self])


@pytest.mark.parametrize("every", [5, 23])
def test_two_viewers_see_the_best_map_at_every_time(drive, every):
    """One looks from the first scan on, one joins later; the past is resampled and corrected meanwhile."""
    observed, first, late = ObservedRun(every), PageClient(), PageClient()
    viewers = [(first, observed.live.add_viewer(lambda: None))]

    def check(state):
        if observed.scans > 210 and len(viewers) == 1:
            viewers.append((late, observed.live.add_viewer(lambda: None)))
        for client, viewer in viewers:
            client.catch_up(viewer)
            assert client.sees(state.maps.occupancy(state.best))
            assert client.status["best"] == state.best
            for particle in range(6):
                past = state.ancestry.trajectory(particle)[:, :2]
                assert client.past_of(particle) == pytest.approx(past, abs=0.008)

    observed.check = check
    observed.go(drive)
    assert len(first.series) == first.status["keys"]
    assert np.array_equal(first.series, late.series)
    assert (first.series[:, 3].astype(int) & CORRECTED).any(), "the drive was to correct the past"
    assert first.status["closures"] >= len(first.arrays["closures"]) > 0


def test_the_filter_gives_the_same_bytes_with_and_without(drive):
    slam, rng = build(RESAMPLING), np.random.default_rng(3)
    alone = run(drive[:150], replace(slam, particles=6), rng=rng).to_arrays()
    observed = ObservedRun()
    viewer = observed.live.add_viewer(lambda: None)
    observed.check = lambda state: viewer.next_message()
    watched = observed.go(drive[:150]).to_arrays()
    assert alone.keys() == watched.keys()
    for name, array in alone.items():
        assert array.tobytes() == watched[name].tobytes(), name


def test_a_slow_reader_gets_fewer_snapshots_and_all_that_changed(drive):
    """While a snapshot is not done with none is taken, and nothing waits; the next brings all."""
    observed, client, late = ObservedRun(), PageClient(), []
    viewer = observed.live.add_viewer(lambda: None)

    def post(snapshot):
        observed.posted += 1
        late.append(snapshot)

    def finish(report, state, seconds):
        observed(report, state, seconds)
        if late and observed.scans % 10 == 0:
            observed.live.apply(late.pop())
            observed.observer.release()

    observed.observer._post = post
    slam, rng = build(RESAMPLING), np.random.default_rng(3)
    state = run(drive[:120], replace(slam, particles=6), rng=rng, observers=[finish])
    assert observed.posted <= 13
    for snapshot in late:
        observed.live.apply(snapshot)
    observed.observer.release()
    observed.observer._take_snapshot(0.0)
    for snapshot in late[-1:]:
        observed.live.apply(snapshot)
    client.catch_up(viewer)
    assert client.sees(state.maps.occupancy(state.best))
    assert client.status["scans"] == 120
    assert len(client.series) == client.status["keys"]


def test_what_cannot_be_asked_is_refused():
    observed = ObservedRun()
    viewer = observed.live.add_viewer(lambda: None)
    for command in ({"do": "fly"}, {"do": "select", "particle": 0}, {"do": "speed", "factor": 0}):
        with pytest.raises(ArgumentError):
            viewer.command(command)
    with pytest.raises(KeyError):
        viewer.command({"what": "pause"})
