"""A run written between two scans and read back goes on to the same bytes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gridslam.config import build, override, preset
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.io.results.state import SavedRun, read_state, write_state
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

SCANS = 160


@pytest.fixture(scope="module")
def measurements():
    rng = np.random.default_rng(2)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return log.measurements[:SCANS]


def begun(name="default"):
    config = override(preset(name), "particles=5", "when_to_resample.kind=AlwaysResample")
    return SavedRun(config, None, np.random.default_rng(7))


def go_on(saved, measurements, threads=1):
    slam = build(saved.configuration, threads)
    observers = [saved.trajectory, saved.statistics]
    state = run(measurements, slam, particles=5, rng=saved.rng, observers=observers, state=saved.state)
    return SavedRun(saved.configuration, state, saved.rng, saved.trajectory, saved.statistics)


def answer(saved):
    grid = saved.state.maps.occupancy(saved.state.best)
    full, online = saved.trajectory.best_trajectory(saved.state), saved.trajectory.online_trajectory()
    arrays = full.stamps_ns, full.poses, online.poses, saved.state.log_weights, grid.log_odds, grid.known
    return grid.origin, grid.log_odds.shape, [array.tobytes() for array in arrays], saved.rng.bit_generator.state


@pytest.mark.parametrize("name", ["default", "gmapping"])
def test_a_run_cut_anywhere_gives_the_same_bytes(measurements, tmp_path, name):
    whole = go_on(begun(name), measurements)
    cuts = [1, 2, 61, 62, 130, SCANS - 1]  # after the first scan, before and after key scans, before the last scan
    saved = begun(name)
    for first, last in zip([0, *cuts], [*cuts, SCANS], strict=True):
        saved = go_on(saved, measurements[first:last], threads=1 + first % 2)
        write_state(tmp_path / "run.npz", saved)
        saved = read_state(tmp_path / "run.npz", threads=2)
    assert answer(saved) == answer(whole)
    ours, expected = saved.statistics.summary(), whole.statistics.summary()
    assert (ours.scans, ours.key_scans, ours.skipped) == (SCANS, expected.key_scans, expected.skipped)
    assert ours.resamplings == expected.resamplings
    assert ours.resamplings > 10  # else the generator and the shared tiles would hardly be tried


def test_writing_does_not_consume_and_equal_runs_give_equal_files(measurements, tmp_path):
    saved = go_on(begun(), measurements[:40])
    write_state(tmp_path / "a.npz", saved)
    write_state(tmp_path / "b.npz", saved)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    go_on(saved, measurements[40:50])


@pytest.fixture(scope="module")
def file(measurements, tmp_path_factory):
    path = tmp_path_factory.mktemp("state") / "run.npz"
    write_state(path, go_on(begun(), measurements[:30]))
    return path


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("schema", "gridslam.saved_run/1", "expected schema gridslam.saved_run/5, got gridslam.saved_run/1"),
        ("configuration", "particles = 0", "particles: expected a number greater than or equal to 1"),
        ("configuration", None, "a text named configuration"),
        ("generator", "{}", "generator: expected the state of PCG64"),
        ("generator", json.dumps({"bit_generator": "MT19937"}), "generator: expected the state of PCG64"),
        ("state.schema", "gridslam.state/1", "a state of schema gridslam.state/10"),
        ("state.poses", None, "an array named poses"),
        ("state.maps.pages", None, "the arrays roots"),
        ("trajectory.keys", np.zeros(2), "keys: expected int64"),
        ("statistics.counts", None, "an array named counts"),
        ("state.poses", np.full((5, 3), np.nan), "state.poses: expected numbers from -1e+09 to 1e+09, got nan"),
        ("state.poses", np.full((5, 3), 2e6), "state.poses: expected poses on the map"),
        ("state.tracker.matched_map", np.array(2), "state.tracker.matched_map: expected numbers from 0 to 1, got 2"),
        ("state.tracker.velocity_variances", np.array([0.1, -1.0]), "expected numbers from 0 to 1e+18, got -1.0"),
        ("state.log_weights", np.full(3, np.inf), "state.log_weights: expected numbers"),
        ("trajectory.keys", np.zeros(30, np.int64), "trajectory.keys: expected key scans 0 to"),
        ("state.closure_state.online_poses", np.zeros((1, 3)), "online_poses: expected"),
    ],
)
def test_what_is_wrong_with_a_file_is_told(file, tmp_path, name, value, message):
    with np.load(file) as archive:
        arrays = dict(archive)
    assert name in arrays
    arrays = {key: array for key, array in arrays.items() if key != name} | ({} if value is None else {name: value})
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError) as caught:
        read_state(tmp_path / "bad.npz")
    assert str(tmp_path / "bad.npz") in str(caught.value)
    assert message in str(caught.value)


def test_other_files_are_refused(file, tmp_path):
    path = tmp_path / "bad.npz"
    for content in (b"", b"hello", file.read_bytes()[:-200]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.npz"):
            read_state(path)


def test_generators_without_plain_state_and_unwritable_places_are_refused(file, tmp_path):
    saved = read_state(file)
    other = SavedRun(saved.configuration, saved.state, np.random.Generator(np.random.MT19937(1)))
    with pytest.raises(ArgumentError, match="a generator over PCG64 or PCG64DXSM, got MT19937"):
        write_state(tmp_path / "run.npz", other)
    with pytest.raises(OutputError, match="cannot be written"):
        write_state(tmp_path / "none" / "run.npz", saved)
    assert not list(tmp_path.iterdir())
