"""A localization saved between two scans goes on to the same bytes; what is none is refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.errors import ConsumedStateError, InputError
from gridslam.io.sessions.archive_file import write_sealed_arrays
from gridslam.io.sessions.saved_localization import SavedLocalization, read_localization, write_localization
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.pipeline import run
from support.localization_world import drive, flat_map


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


@pytest.fixture(scope="module")
def measurements():
    return drive(1).measurements[:40]


def went_on(measurements, mcl, state, rng):
    """All that comes of the rest of a log."""
    told = []

    def observe(report, state, seconds):
        told.append((report.pose.tobytes(), report.covariance.tobytes(), report.lost_probability))

    end = run(measurements, mcl, rng=rng, state=state, observers=[observe])
    return told, end.poses.tobytes(), end.hypotheses.log_odds.tobytes(), end.updates


@pytest.mark.parametrize("scans", [0, 1, 3, 25])  # nothing known, one scan, rivals about, found
def test_goes_on_to_the_same_bytes(known, measurements, tmp_path, scans):
    configuration = MonteCarloConfiguration(max_beams=60)
    mcl, rng = MonteCarloLocalization(known, configuration), np.random.default_rng(5)
    state = run(measurements[:scans], mcl, rng=rng, state=mcl.init())
    write_localization(tmp_path / "saved.npz", SavedLocalization(configuration, state, rng))
    saved = read_localization(tmp_path / "saved.npz")
    assert saved.configuration == configuration
    resumed = MonteCarloLocalization(known, saved.configuration)
    rest = measurements[scans:]
    assert went_on(rest, mcl, state, rng) == went_on(rest, resumed, saved.state, saved.rng)


def test_what_is_no_saved_localization(known, measurements, tmp_path):
    path, rng = tmp_path / "saved.npz", np.random.default_rng(0)
    mcl = MonteCarloLocalization(known)
    state = run(measurements[:2], mcl, rng=rng, state=mcl.init())
    write_localization(path, SavedLocalization(mcl.configuration, state, rng))
    whole = dict(np.load(path))
    for name, wrong in (
        ("state.poses", np.zeros((4, 2))),
        ("state.log_weights", np.zeros(3)),
        ("state.hypotheses.log_odds", np.zeros(99)),
        ("generator", np.array("{}")),
        ("state.log_weights", np.full_like(whole["state.log_weights"], -np.inf)),
        ("state.averages.fast", np.array(-1.0)),
        ("state.tracked.tracker.odometry_errors.factors", np.full(6, 1e15)),
        ("state.tracked.tracker.odometry_errors.variances", np.zeros(2)),
        ("configuration", np.array('{"max_beams": 0}')),
        ("schema", np.array("other/1")),
        ("state.tracked.tracker.matched_map", np.array(2)),
        ("state.tracked.tracker.maps.first", np.array([1 << 40, 0])),
    ):
        assert name in whole
        write_sealed_arrays(path, {**whole, name: wrong})
        with pytest.raises(InputError, match=r"saved\.npz"):
            read_localization(path)
        write_sealed_arrays(path, {key: array for key, array in whole.items() if key != name})
        with pytest.raises(InputError, match=r"saved\.npz"):
            read_localization(path)
    write_sealed_arrays(path, {**whole, "state.odometry": np.full(3, np.nan)})
    with pytest.raises(InputError, match=r"state\.odometry|odometry: expected numbers"):
        read_localization(path)
    mcl.step(state, *measurements[2], rng)
    with pytest.raises(ConsumedStateError):
        write_localization(path, SavedLocalization(mcl.configuration, state, rng))
