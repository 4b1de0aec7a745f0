"""A run that closes a loop, cut anywhere: also between a closure and the correction that is drawn for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.io.sessions.session_file import SavedRun, SavedSession, read_session, write_session
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from support.loops import PROVOKED, loop_drive

CONFIG = override(PROVOKED, "particles=3", "loop_closure.scans_per_step=5", "loop_closure.poses_per_scan=1")
"""The graph is solved and the correction drawn slowly."""

SLAM = build(CONFIG)


@pytest.fixture(scope="module")
def loop():
    return loop_drive()


@pytest.fixture(scope="module")
def whole(loop, play):
    return play(SLAM, loop.measurements, particles=3, seed=7)


@pytest.fixture(scope="module")
def cuts(loop, whole):
    """Scans after which to cut: while the graph is solved, at the closure, while the correction is drawn, and after."""
    reports = whole[1]
    closed = next(k for k, report in enumerate(reports) if report.closures)
    merged = next(k for k, report in enumerate(reports) if report.corrected)
    assert 100 < closed < merged - 20 < len(loop.measurements) - 40  # else it would prove little
    return [closed - 5, closed, closed + 1, (closed + merged) // 2, merged, merged + 1, len(reports) - 1]


def test_a_run_that_is_written_and_read_goes_on_to_the_same_bytes(loop, contents, whole, cuts, tmp_path):
    saved = SavedRun(np.random.default_rng(7))
    pending = []
    for first, last in zip([0, *cuts], [*cuts, len(loop.measurements)], strict=True):
        slam = build(CONFIG, threads=1 + len(pending) % 2)
        observers = [saved.trajectory, saved.statistics]
        measurements = loop.measurements[first:last]
        state = run(measurements, replace(slam, particles=3), rng=saved.rng, observers=observers, state=saved.state)
        pending.append(state.closure_state.correction is not None)
        write_session(tmp_path / "run.gridslam", SavedSession(CONFIG, run=replace(saved, state=state)))
        saved = read_session(tmp_path / "run.gridslam", threads=2).run
        assert contents(saved.state) == contents(state)
    assert pending[:6] == [False, False, True, True, True, False]
    assert contents(saved.state) == contents(whole[0])
    assert saved.statistics.summary().corrections == sum(report.corrected for report in whole[1])
    assert saved.state.closure_state.rejected == whole[0].closure_state.rejected


def test_final_refinement_changes_nothing_and_is_the_same_after_reading(loop, contents, tmp_path):
    first = SavedRun(np.random.default_rng(7))
    state = run(loop.measurements, replace(SLAM, particles=3), rng=first.rng, observers=[first.trajectory])
    before = contents(state)
    write_session(tmp_path / "run.gridslam", SavedSession(CONFIG, run=replace(first, state=state)))
    read = read_session(tmp_path / "run.gridslam").run
    words = [
        full_slam(s, [first.trajectory.tracked_scans()], CONFIG.mapper, CONFIG.loop_closure)
        for s in (state, state, read.state)
    ]
    assert contents(state) == before
    for word in words[1:]:
        for name in ("poses", "covariances"):
            assert getattr(word, name).tobytes() == getattr(words[0], name).tobytes()
        assert word.graph.poses.tobytes() == words[0].graph.poses.tobytes()
        assert word.map.log_odds.tobytes() == words[0].map.log_odds.tobytes()


def test_the_page_on_the_state_names_every_array(loop, play, cuts):
    page = (Path(__file__).parents[3] / "docs" / "state.md").read_text(encoding="utf-8")
    state, _ = play(SLAM, loop.measurements[: cuts[3]], particles=3, seed=7)
    for name in state.to_arrays():
        own = name.removeprefix("closure_state.")
        assert f"`{own.rpartition('maps.')[2]}`" in page, name
