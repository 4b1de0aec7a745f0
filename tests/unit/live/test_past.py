"""A running filter is shown as it was at any time before."""

import numpy as np
import pytest
from test_live_run import ObservedRun

from support.loops import loop_drive
from support.page_client import PageClient


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements[:330]


def test_a_running_filter_is_seen_as_it_was_while_it_goes_on(drive):
    observed, client, now = ObservedRun(every=3), PageClient(), PageClient()
    viewer, other = (observed.live.add_viewer(lambda: None) for _ in range(2))
    seen = []

    def note(report, state, seconds):
        if report.skipped is None:
            path = state.ancestry.trajectory(state.best)[:, :2]
            seen.append((state.maps.occupancy(state.best), path, np.array(report.pose)))

    def check(state):
        now.catch_up(other)
        assert now.sees(state.maps.occupancy(state.best)), "whoever looks at the present is not disturbed"
        if observed.scans < 60:
            return
        at = (7 * observed.scans) % (len(seen) - 3)
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        grid, path, pose = seen[at]
        assert client.sees(grid)
        assert client.path == pytest.approx(path, abs=1e-5)
        assert client.status["pose"] == pytest.approx(pose)
        assert (client.status["at"], client.status["keys"]) == (at, at + 1)
        assert len(client.arrays["particles"]) == 6

    observed.check = check
    observed.go(drive[:250], before=note)
    viewer.command({"do": "seek", "at": 10**6})
    client.catch_up(viewer)
    assert client.sees(seen[-1][0])
    assert "at" not in client.status
