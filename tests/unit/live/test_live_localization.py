"""The page of a robot in a known map shows the belief as it is, and the filter does not notice."""

import dataclasses

import numpy as np
import pytest

from gridslam.api.localization import localize
from gridslam.io.carmen.writer import write_carmen
from gridslam.live.history import LOST
from gridslam.live.observer import LiveObserver
from gridslam.live.recorder import RunRecorder
from gridslam.live.run import LiveRun
from gridslam.sim import OdometryNoise
from support.localization_world import drive, flat_map
from support.page_client import PageClient


@pytest.fixture(scope="module")
def grid():
    return flat_map()


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("flat") / "flat.clf"
    write_carmen(path, drive(1, OdometryNoise()).measurements)
    return path


class ObservedLocalization:
    """A localization that is looked at without a server, at every scan."""

    def __init__(self, grid):
        self.live, self.client, self.checked = LiveRun("flat", grid), PageClient(), 0
        self.observer = self.live.observer = LiveObserver(self.live.show, RunRecorder(30.0))
        self.viewer = self.live.add_viewer()
        self.observer.period_s = 0.0
        self.client.catch_up(self.viewer)

    def go(self, log, grid, check=lambda report, state: None):
        def seen(report, state, seconds):
            self.client.catch_up(self.viewer)
            check(report, state)
            self.checked += 1

        return localize(log, grid, seed=2, observers=[self.observer, seen], gate=self.observer.pace)


def test_the_map_is_there_before_the_first_scan_and_sent_once(grid, log):
    observed = ObservedLocalization(grid)
    client = observed.client
    assert client.sees(grid)
    assert (client.status["stage"], client.run_info["step"]) == ("waiting", "update")
    assert "closures" not in client.run_info["layers"]
    client.arrays.pop("tiles")
    observed.go(log, grid)
    assert observed.checked > 100
    assert "tiles" not in client.arrays


def test_the_belief_is_seen_as_it_is(grid, log):
    observed, way, lost = ObservedLocalization(grid), [], []
    client = observed.client

    def check(report, state):
        particles = client.arrays["particles"]
        assert len(particles) <= 1000
        assert particles[:, 3].sum() == pytest.approx(1.0, abs=1e-3)
        # of some 2000 particles each second is shown
        near = np.hypot(*(particles[:, :2] - report.pose[:2]).T) < 1.0
        assert particles[near, 3].sum() == pytest.approx(state.estimate.mass, abs=0.1)
        status = client.status
        assert status["pose"] == report.pose.tolist()
        assert (status["lost"], status["lost_probability"]) == (report.lost, report.lost_probability)
        assert (status["inlier_ratio"], status["particles"]) == (report.inlier_ratio, report.particles)
        if report.skipped is None:
            way.append(np.full(2, np.nan) if report.lost else report.pose[:2])
            lost.append(report.lost)
            assert status["n_eff"] == pytest.approx(report.n_eff, rel=1e-6)
            assert client.series[-1, 4] == len(report.poses)
        np.testing.assert_allclose(client.path, np.array(way), atol=1e-5)

    observed.go(log, grid, check)
    assert 0 < sum(lost) < len(lost)
    np.testing.assert_array_equal(client.series[:, 3], LOST * np.array(lost))
    assert len(client.series) == client.status["keys"]


def test_the_filter_gives_the_same_bytes_with_and_without(grid, log):
    alone, watched = localize(log, grid, seed=2), ObservedLocalization(grid).go(log, grid)
    assert len(alone.reports) == len(watched.reports) > 100
    for one, other in zip(alone.reports, watched.reports, strict=True):
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    assert alone.state.poses.tobytes() == watched.state.poses.tobytes()
