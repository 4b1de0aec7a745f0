"""What viewers have of a run is what the filter has, and the filter does not notice."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.errors import ArgumentError
from gridslam.live.history import CORRECTED
from gridslam.live.observer import LiveObserver
from gridslam.live.recorder import RunRecorder
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
        self.live = LiveRun("loop")
        self.observer = self.live.observer = LiveObserver(self.show, RunRecorder(30.0))
        self.every, self.scans, self.shown = every, 0, 0
        self.check = lambda state: None

    def show(self, scene):
        self.shown += 1
        self.live.show(scene)

    def __call__(self, report, state, seconds):
        self.scans += 1
        self.observer.period_s = 0.0 if self.scans % self.every == 0 else float("inf")
        self.observer._due = 0.0 if self.scans % self.every == 0 else float("inf")
        shown = self.shown
        self.observer(report, state, seconds)
        if self.shown > shown:
            self.check(state)

    def go(self, measurements):
        slam, rng = build(RESAMPLING), np.random.default_rng(3)
        return run(self.observer.pace(measurements), replace(slam, particles=6), rng=rng, observers=[self])


@pytest.mark.parametrize("every", [5, 23])
def test_two_viewers_see_the_best_map_at_every_time(drive, every):
    """One looks from the first scan on, one joins later; the past is resampled and corrected meanwhile."""
    observed, first, late = ObservedRun(every), PageClient(), PageClient()
    viewers = [(first, observed.live.add_viewer())]

    def check(state):
        if observed.scans > 210 and len(viewers) == 1:
            viewers.append((late, observed.live.add_viewer()))
        for client, viewer in viewers:
            client.catch_up(viewer)
            assert client.sees(state.maps.occupancy(state.best))
            assert client.status["best"] == state.best
            assert client.path == pytest.approx(state.ancestry.trajectory(state.best)[:, :2], abs=1e-5)

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
    viewer = observed.live.add_viewer()
    observed.check = lambda state: viewer.next_message()
    watched = observed.go(drive[:150]).to_arrays()
    assert alone.keys() == watched.keys()
    for name, array in alone.items():
        assert array.tobytes() == watched[name].tobytes(), name


def test_a_viewer_that_reads_rarely_gets_all_that_changed(drive):
    """Nothing waits for a viewer, and its next message brings all."""
    observed, client = ObservedRun(), PageClient()
    viewer = observed.live.add_viewer()

    def check(state):
        if observed.scans % 50 == 0:
            client.receive(viewer.next_message())

    observed.check = check
    state = observed.go(drive[:120])
    client.catch_up(viewer)
    assert client.sees(state.maps.occupancy(state.best))
    assert client.messages < 10
    assert client.status["scans"] == 120
    assert len(client.series) == client.status["keys"]


def test_a_run_is_shown_at_a_bounded_rate(drive):
    observed = ObservedRun(every=10)
    observed.go(drive[:125])
    assert observed.shown == 13, "every tenth scan, and the end"


def test_a_running_filter_takes_no_commands():
    viewer = ObservedRun().live.add_viewer()
    with pytest.raises(ArgumentError, match="do: expected nothing while the filter runs, got seek"):
        viewer.command({"do": "seek", "at": 0})


def test_speed_is_that_of_the_stamps(drive, monkeypatch):
    """Each scan comes when it is due, at ten times real time; without a speed at once."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(time, "perf_counter", lambda: clock.now)
    monkeypatch.setattr(time, "sleep", lambda seconds: setattr(clock, "now", clock.now + seconds))
    observer = ObservedRun().observer
    for speed in (None, 10.0):
        clock.now, observer.speed = 100.0, speed
        for measurement in observer.pace(drive[:60]):
            passed_s = 1e-9 * (measurement.scan.stamp_ns - drive[0].scan.stamp_ns)
            assert clock.now - 100.0 == pytest.approx(0.0 if speed is None else passed_s / speed, abs=1e-6)
    assert passed_s > 3.0
