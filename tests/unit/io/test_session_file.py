"""A run written between two scans and read back goes on to the same bytes."""

import json
import math
import operator
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from gridslam.api.session import Session
from gridslam.config import build, override, preset
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.io.sessions.archive_file import read_arrays, write_arrays
from gridslam.io.sessions.session_file import (
    SESSION_SCHEMA,
    SavedRun,
    SavedSession,
    read_session,
    write_session,
)
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.grid_fastslam.state import STATE_SCHEMA
from support.saved_sessions import make_session

SCANS = 160
LOG = {"path": "a.clf", "sha256": "", "scans": 1, "first_stamp_ns": 0, "last_stamp_ns": 1, "length_m": 1.0}


@pytest.fixture(scope="module")
def measurements():
    rng = np.random.default_rng(2)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return log.measurements[:SCANS]


def begun(name="default"):
    config = override(preset(name), "particles=5", "when_to_resample.kind=AlwaysResample")
    return SavedSession(config, run=SavedRun(np.random.default_rng(7)))


def go_on(saved, measurements, threads=1):
    slam = build(saved.configuration, threads)
    begun = saved.run
    observers = [begun.trajectory, begun.statistics]
    state = run(measurements, replace(slam, particles=5), rng=begun.rng, observers=observers, state=begun.state)
    return replace(saved, run=replace(begun, state=state))


def answer(session):
    saved = session.run
    grid = saved.state.maps.occupancy(saved.state.best)
    full, online = saved.trajectory.best_trajectory(saved.state), saved.trajectory.online_trajectory()
    arrays = full.stamps_ns, full.poses, online.poses, saved.state.log_weights, grid.log_odds, grid.known
    return (
        saved.statistics.summary().particles_mean,
        grid.origin,
        grid.log_odds.shape,
        [array.tobytes() for array in arrays],
        saved.rng.bit_generator.state,
    )


@pytest.mark.parametrize("name", ["default", "gmapping"])
def test_a_run_cut_anywhere_gives_the_same_bytes(measurements, tmp_path, name):
    whole = go_on(begun(name), measurements)
    cuts = [1, 2, 61, 62, 130, SCANS - 1]  # after the first scan, before and after key scans, before the last scan
    saved = begun(name)
    for first, last in zip([0, *cuts], [*cuts, SCANS], strict=True):
        saved = go_on(saved, measurements[first:last], threads=1 + first % 2)
        write_session(tmp_path / "run.gridslam", saved)
        saved = read_session(tmp_path / "run.gridslam", threads=2)
    assert answer(saved) == answer(whole)
    ours, expected = saved.run.statistics.summary(), whole.run.statistics.summary()
    assert (ours.scans, ours.key_scans, ours.skipped) == (SCANS, expected.key_scans, expected.skipped)
    assert ours.resamplings == expected.resamplings
    assert ours.resamplings > 10  # else the generator and the shared tiles would hardly be tried


def write_drive(path, measurements):
    """Write a session with the map of a drive as a piece of its own, too."""
    session = Session.of(go_on(begun(), measurements))
    write_session(path, replace(session.saved, pieces=tuple(session.pieces)))
    return path


@pytest.fixture(scope="module")
def file(measurements, tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("state") / "run.gridslam", measurements[:30])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("schema", "gridslam.session/99", f"expected schema {SESSION_SCHEMA}, got gridslam.session/99"),
        ("head", None, "a text named head"),
        ("head.configuration", "particles = 0", "particles: expected a number greater than or equal to 1"),
        ("head.run.generator", {}, "generator: expected the state of PCG64"),
        ("head.run.generator", {"bit_generator": "MT19937"}, "generator: expected the state of PCG64"),
        ("head.run.logs", [{"path": "day.clf"}], "arrays do not belong together"),
        ("head.run.logs", [{**LOG, "scans": "many"}], "scans: expected int, got 'many'"),
        ("head.run.logs", [{**LOG, "length_m": 10**400}], "numbers up to 1e300"),
        ("head.run.earlier", [math.inf], "drives: expected dict, got inf"),
        ("head.run.name", 5, "name: expected str, got 5"),
        ("head.pieces", [[None]], "drives: expected dict, got None"),
        ("head.seed", -1, "seed: expected a number >= 0"),
        ("head", np.array("[]"), "head: expected dict"),
        ("head", np.array("5"), "head: expected dict"),
        ("head", np.array("[" * 5000), "values nested too deeply"),
        ("run.state.schema", "gridslam.state/1", f"a state of schema {STATE_SCHEMA}"),
        ("run.state.poses", None, "an array named poses"),
        ("run.state.maps.pages", None, "the arrays roots"),
        ("run.trajectory.keys", np.zeros(2), "keys: expected int64"),
        ("run.statistics.counts", None, "an array named counts"),
        ("run.state.tracker.matched_map", np.array(2), "tracker.matched_map: expected numbers from 0 to 1, got 2"),
        ("run.state.closure_state.online_poses", np.zeros((1, 3)), "online_poses: expected"),
        ("pieces.0.scans.keys", np.array([0, 0]), "scans.keys: expected"),
        ("pieces.0.graph.poses", None, "an array named graph.poses"),
        ("pieces.0.drives.0.keys", np.zeros(3, np.int64), "keys: expected int64 of shape (30)"),
        ("run.state.closure_state.scans.keys", np.array([1, 0]), "keys: expected"),
        ("run.state.closure_state.graph.frozen", np.array(10_000), "frozen: expected numbers from 0 to"),
        ("run.state.closure_state.search.first_key", np.array(10_000), "first_key: expected numbers"),
        ("run.state.ancestry.leaves", np.zeros(5, np.int64) - 1, "ancestry.parents, leaves: expected"),
        ("run.state.maps.roots", np.zeros((5, 0, 0), np.int32), "maps.roots: expected at least one map"),
        ("run.state.log_weights", np.full(5, -np.inf), "log_weights: expected no NaN, none +inf and not all -inf"),
        ("run.state.tracker.odometry_errors.factors", np.full(6, 1e6), "factors: expected numbers from -1000.0 to"),
        ("run.state.tracker.odometry_errors.variances", np.zeros(2), "variances: expected numbers from 1e-12"),
        ("pieces.0.scans.origins", np.full((29, 2), 1e6), "origins: expected numbers from -1000.0 to"),
    ],
)
def test_what_is_wrong_with_a_file_is_told(file, tmp_path, name, value, message):
    with np.load(file) as archive:
        arrays = dict(archive)
    if name.startswith("head."):
        head = json.loads(str(arrays["head"]))
        *parts, last = name.split(".")[1:]
        parts = [int(part) if part.isdigit() else part for part in (*parts, last)]
        reduce(operator.getitem, parts[:-1], head)[parts[-1]] = value
        arrays["head"] = np.array(json.dumps(head))
    else:
        assert name in arrays
        arrays = {key: array for key, array in arrays.items() if key != name} | ({} if value is None else {name: value})
    write_arrays(tmp_path / "bad.gridslam", arrays)
    with pytest.raises(InputError) as caught:
        read_session(tmp_path / "bad.gridslam")
    assert str(tmp_path / "bad.gridslam") in str(caught.value)
    assert message in str(caught.value)


def test_a_changed_byte_is_found_or_changes_nothing(measurements, tmp_path):
    """Files, each with one bit changed or cut off somewhere, one for each 160 bytes; some bits of zip mean nothing."""
    file = write_drive(tmp_path / "run.gridslam", measurements[:14])
    whole = read_arrays(file, SESSION_SCHEMA, "a session")
    content = file.read_bytes()
    rng = np.random.default_rng(3)
    path = tmp_path / "bad.gridslam"
    found = []
    for _ in range(len(content) // 160):
        place = int(rng.integers(len(content)))
        changed = bytearray(content)
        changed[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(changed) if rng.integers(4) else content[:place])
        try:
            arrays = read_arrays(path, SESSION_SCHEMA, "a session")
            read_session(path)  # which misses arrays that a changed list of contents has lost
        except InputError as error:
            found.append(str(error))
            continue
        assert arrays.keys() == whole.keys()
        assert all(arrays[name].tobytes() == values.tobytes() for name, values in whole.items())
    assert all("bad.gridslam" in line for line in found)
    assert len(found) > 0.9 * (len(content) // 160)


def test_generators_without_plain_state_and_unwritable_places_are_refused(file, tmp_path):
    saved = read_session(file)
    other = replace(saved, run=replace(saved.run, rng=np.random.Generator(np.random.MT19937(1))))
    with pytest.raises(ArgumentError, match="a generator over PCG64 or PCG64DXSM, got MT19937"):
        write_session(tmp_path / "run.gridslam", other)
    (tmp_path / "none").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_session(tmp_path / "none" / "run.gridslam", saved)
    assert [path.name for path in tmp_path.iterdir()] == ["none"]


KEPT = sorted(Path(__file__).parent.glob("session_*.gridslam"))


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_every_earlier_schema_is_read(path, measurements):
    session = Session.open(path)
    assert [drive.name for drive in session.saved.drives] == ["monday", "tuesday"]
    assert [len(piece.piece) for piece in session.pieces] == [14, 12]
    assert [len(trajectory) for trajectory in session.trajectories.values()] == [60, 60]
    assert all((grid.whole().log_odds > 1).sum() > 100 for grid in session.maps)
    saved = session.saved
    run(measurements[:20], build(saved.configuration), rng=saved.run.rng, state=saved.run.state)


def test_what_a_session_holds_changes_with_the_number_of_its_schema(tmp_path):
    """Else a file of this version would be refused, or misread, by one that has the same number."""
    write_session(tmp_path / "now.gridslam", make_session())
    with np.load(tmp_path / "now.gridslam") as archive, np.load(KEPT[-1]) as kept:
        assert KEPT[-1].stem == f"session_{SESSION_SCHEMA.rpartition('/')[2]}"
        forms = [
            {name: (values.dtype.kind, values.ndim) for name, values in arrays.items()} for arrays in (archive, kept)
        ]
        assert forms[0] == forms[1]
        heads = [json.loads(str(arrays["head"])) for arrays in (archive, kept)]
        assert heads[0].keys() == heads[1].keys()
        assert heads[0]["run"].keys() == heads[1]["run"].keys()
