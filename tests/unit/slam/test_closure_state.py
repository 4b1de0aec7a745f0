"""A run that closes a loop, cut anywhere: also between a closure and the correction that is drawn for it."""

from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.io.sessions.session_file import SavedRun, SavedSession, read_session, write_session
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.types import StepReport
from support.loops import PROVOKED, loop_drive

CONFIG = override(PROVOKED, "particles=3", "loop_closure.scans_per_step=5", "loop_closure.poses_per_scan=1")
"""The graph is solved and the correction drawn slowly."""

SLAM = build(CONFIG)


@pytest.fixture(scope="module")
def loop():
    return loop_drive()


class Whole(NamedTuple):
    """The run at once: its reports, and what has recorded it."""

    saved: SavedRun
    reports: list[StepReport]


@pytest.fixture(scope="module")
def whole(loop):
    saved, reports = SavedRun(np.random.default_rng(7)), []
    observers = [saved.trajectory, lambda report, state, seconds: reports.append(report)]
    state = run(loop.measurements, replace(SLAM, particles=3), rng=saved.rng, observers=observers)
    return Whole(replace(saved, state=state), reports)


@pytest.fixture(scope="module")
def cuts(loop, whole):
    """Scans after which to cut: while the graph is solved, at the closure, while the correction is drawn, and after."""
    reports = whole.reports
    closed = next(k for k, report in enumerate(reports) if report.closures)
    merged = next(k for k, report in enumerate(reports) if report.corrected)
    assert 100 < closed < merged - 20 < len(loop.measurements) - 40  # else it would prove little
    return [closed - 5, closed, closed + 1, (closed + merged) // 2, merged, merged + 1, len(reports) - 1]


def test_a_run_that_is_written_and_read_goes_on_to_the_same_bytes(loop, contents, whole, cuts, tmp_path):
    """And the page on the state names every array."""
    page = (Path(__file__).parents[3] / "docs" / "state.md").read_text(encoding="utf-8")
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
        names = [name.removeprefix("closure_state.").rpartition("maps.")[2] for name in state.to_arrays()]
        assert [name for name in names if f"`{name}`" not in page] == []
    assert pending[:6] == [False, False, True, True, True, False]
    assert contents(saved.state) == contents(whole.saved.state)
    assert saved.statistics.summary().corrections == sum(report.corrected for report in whole.reports)
    assert saved.state.closure_state.rejected == whole.saved.state.closure_state.rejected


def test_final_refinement_changes_nothing_and_is_the_same_after_reading(whole, contents, tmp_path):
    first, state = whole.saved, whole.saved.state
    before = contents(state)
    write_session(tmp_path / "run.gridslam", SavedSession(CONFIG, run=first))
    read = read_session(tmp_path / "run.gridslam").run
    words = [
        full_slam(s, [first.trajectory.tracked_scans()], CONFIG.mapper, CONFIG.loop_closure)
        for s in (state, read.state)
    ]
    assert contents(state) == before
    for name in ("poses", "covariances", "graph.poses", "map.log_odds"):
        once, again = (attrgetter(name)(word).tobytes() for word in words)
        assert once == again, name
