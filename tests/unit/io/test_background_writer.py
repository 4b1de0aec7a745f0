"""A session is written while the filter goes on: as the run was when the writing began."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import build, override, preset
from gridslam.grid import TileMaps
from gridslam.io.sessions.background_writer import BackgroundWriter
from gridslam.io.sessions.session_file import SavedRun, SavedSession, read_session, write_session
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

SAVED_AFTER = (0, 30, 31, 62, 90)


@pytest.fixture(scope="module")
def measurements():
    rng = np.random.default_rng(4)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return log.measurements[:110]


def test_what_is_written_is_the_run_as_it_was_then_whatever_the_filter_does_meanwhile(measurements, tmp_path):
    configuration = override(preset("default"), "particles=5", "when_to_resample.kind=AlwaysResample")
    begun = SavedSession(configuration, run=SavedRun(np.random.default_rng(7)))
    writers = []

    def save(report, state, seconds):
        scan = len(begun.run.trajectory.keys) - 1
        if scan in SAVED_AFTER:
            now = replace(begun, run=replace(begun.run, state=state))
            write_session(tmp_path / f"{scan}.direct", now)
            writers.append(BackgroundWriter())
            writers[-1].write(tmp_path / "aside" / f"{scan}.gridslam", now)

    observers = [begun.run.trajectory, begun.run.statistics, save]
    end = run(measurements, build(configuration), rng=begun.run.rng, observers=observers)
    for writer in writers:
        writer.close()
    assert len(writers) == len(SAVED_AFTER)
    for scan in SAVED_AFTER:
        direct, aside = tmp_path / f"{scan}.direct", tmp_path / "aside" / f"{scan}.gridslam"
        assert aside.read_bytes() == direct.read_bytes()
    assert read_session(tmp_path / "90.direct").run.state.ancestry.steps < end.ancestry.steps


def test_a_run_goes_on_where_there_is_no_memory_for_a_copy(measurements, tmp_path, monkeypatch):
    def fail(*_):
        raise MemoryError

    begun, problems = SavedRun(np.random.default_rng(7)), []
    state = run(measurements[:1], build(override(preset("default"), "particles=2")), rng=begun.rng)
    writer = BackgroundWriter(problems.append)
    monkeypatch.setattr(TileMaps, "copy", fail)
    writer.write(tmp_path / "run.gridslam", SavedSession(preset("default"), run=replace(begun, state=state)))
    writer.close()
    assert "MemoryError" in "".join(problems)
    assert not list(tmp_path.iterdir())
