"""What visitors save while a run goes on: the trajectory that is shown, and the session, if there is one."""

from __future__ import annotations

import urllib.error
import urllib.request

import numpy as np
import pytest

from gridslam.config import build
from gridslam.io.trajectories import read_tum
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.pipeline import run
from support.loops import PROVOKED, loop_drive


def get(url, path):
    address, _, query = url.partition("?")
    with urllib.request.urlopen(f"{address}{path}?{query}", timeout=10) as answer:
        return answer.read()


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_the_trajectory_is_that_of_the_best_particle(tmp_path, host):
    drive, stamps = loop_drive().measurements[:80], []

    def note(report, state, seconds):
        if report.skipped is None:
            stamps.append(report.stamp_ns)

    with LivePage("loop", LiveOptions(host=host, port=0), range_max_m=30.0) as page:
        url = page.url if host == "127.0.0.1" else page.url.replace(page.url.split("/")[2].split(":")[0], "127.0.0.1")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(url, "trajectory.tum")
        rng, observers = np.random.default_rng(1), [page.observer, note]
        state = run(page.pace(drive), build(PROVOKED), particles=4, rng=rng, observers=observers)
        (tmp_path / "t.tum").write_bytes(get(url, "trajectory.tum"))
        saved = read_tum(tmp_path / "t.tum")
        assert saved.stamps_ns.tolist() == stamps
        assert saved.poses == pytest.approx(state.ancestry.trajectory(state.best), abs=1e-6)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(url, "session.gridslam")
        (tmp_path / "session.gridslam").write_bytes(b"all there is")
        page.offer_session(tmp_path / "session.gridslam")
        assert get(url, "session.gridslam") == b"all there is"
        assert "session" in page._run.make_scene(0).run_info["layers"]
        if host == "0.0.0.0":
            for path in ("trajectory.tum", "session.gridslam"):
                with pytest.raises(urllib.error.HTTPError, match="403"):
                    get(url.partition("?")[0], path)
