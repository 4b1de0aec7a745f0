"""A step that raises is skipped, and the run goes on with the state before it, but for maps and tracker."""

import numpy as np
import pytest

from gridslam.config import Configuration, build, override
from gridslam.geometry.se2 import between
from gridslam.grid.arena import TileArena
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.observers import TrajectoryRecorder
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.resampling import Systematic
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.grid_fastslam.report_builder import ReportBuilder
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.tracking.tracker import Tracker
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map

PARTS = [
    (Tracker, "step"),
    (Tracker, "_insert"),
    (GridFastSlamState, "move"),
    (OccupancyGridMapping, "__call__"),
    (TileMaps, "update"),
    (TileArena, "grow"),
    (Ancestry, "extend"),
    (ReportBuilder, "estimate"),
    (Systematic, "__call__"),
    (GridFastSlamState, "resample"),
    (LoopClosure, "__call__"),
]

STEPS = ("when_to_update.rotation_rad=0.25", "when_to_resample.kind=AlwaysResample")  # often, so that all parts fail
SLAM = build(override(Configuration(particles=5), *STEPS))
FAILING = np.random.default_rng(5).permutation(np.arange(1, 300))[:120].tolist()  # scans; many are no key scan


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(2)
    return simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)


@pytest.fixture(scope="module")
def measurements(log):
    return log.measurements[:300]


class Faults:
    """Lets a method raise, once it has done its work, at the first call for each of some scans."""

    def __init__(self, monkeypatch, owner, name, scans):
        self.due = set(scans)
        self.current = -1
        self.hit = []
        real = getattr(owner, name)

        def failing(*arguments, **options):
            result = real(*arguments, **options)
            if self.current in self.due:
                self.due.remove(self.current)
                self.hit.append(self.current)
                raise RuntimeError("injected")
            return result

        monkeypatch.setattr(owner, name, failing)

    def watch(self, measurements):
        for k, measurement in enumerate(measurements):
            self.current = k
            yield measurement


def arrays_of(state):
    return {name: array.tobytes() for name, array in state.to_arrays().items()}


def map_all(source, failures=None, recorder=None):
    recorder = recorder or TrajectoryRecorder()
    rng = np.random.default_rng(3)
    on_failure = None if failures is None else failures.append
    state = run(source, SLAM, rng=rng, observers=[recorder], on_failure=on_failure)
    return arrays_of(state), arrays_of(recorder), rng.bit_generator.state


@pytest.fixture(scope="module")
def begun(measurements):
    """The poses of the first 100 scans where nothing fails."""
    recorder = TrajectoryRecorder()
    state = run(measurements[:100], SLAM, rng=np.random.default_rng(0), observers=[recorder])
    return recorder.best_trajectory(state).poses


def farthest_m(trajectory, log):
    """How far the positions of a trajectory are from the true ones at most."""
    at = np.isin(log.truth.stamps_ns, trajectory.stamps_ns)
    true = between(log.truth.poses[0], log.truth.poses[at])
    return np.hypot(*(between(trajectory.poses[0], trajectory.poses) - true)[:, :2].T).max()


@pytest.mark.parametrize(("owner", "name"), PARTS, ids=[f"{owner.__name__}.{name}" for owner, name in PARTS])
def test_a_step_that_fails_anywhere_is_left_out(log, measurements, monkeypatch, owner, name):
    """All other scans have poses, as exact as those of a log without the failed scans, and two runs give the same.

    That log is mapped to 0.12 to 0.19 m by three seeds, which differ by as much: half of it is added.
    """
    found = []
    for _ in range(2):
        recorder = TrajectoryRecorder()
        failures = []
        with monkeypatch.context() as patched:
            faults = Faults(patched, owner, name, FAILING)
            found.append(map_all(faults.watch(measurements), failures, recorder))
        assert faults.hit
        assert [failure.scan for failure in failures] == [measurements[k].scan for k in faults.hit]
        assert all("RuntimeError: injected (test_failed_steps.py, line" in str(failure) for failure in failures)
    assert found[0] == found[1]
    trajectory = recorder.online_trajectory()
    left = [m.scan.stamp_ns for k, m in enumerate(measurements) if k not in faults.hit]
    assert trajectory.stamps_ns.tolist() == left
    assert farthest_m(trajectory, log) < 0.28


def test_a_measurement_that_is_refused_leaves_the_state_as_it_is(measurements):
    """Nothing of the step has begun, and the last key scan stays."""
    whole = list(measurements)
    for k in range(290, 20, -9):
        whole.insert(k, ("no odometry", measurements[k].scan))
    assert map_all(whole, failures := []) == map_all(measurements)
    assert len(failures) == 30


def test_where_memory_for_tiles_cannot_be_had_the_arena_stays_whole(log, measurements, monkeypatch):
    """Ids of tiles that were never allocated would let the kernels write outside the arena."""
    due = set(range(0, 300, 2))
    current = 0
    real = TileArena._extend_ids

    def scarce(refs):
        free, size = real(refs)
        if current not in due:
            return free, size
        due.remove(current)
        return free, 1 << 40  # as much as no machine has

    def watch():
        nonlocal current
        for k, measurement in enumerate(measurements):
            current = k
            yield measurement

    monkeypatch.setattr(TileArena, "_extend_ids", staticmethod(scarce))
    failures = []
    recorder = TrajectoryRecorder()
    arrays, _, _ = map_all(watch(), failures, recorder)
    monkeypatch.undo()
    assert {type(failure.error) for failure in failures} == {MemoryError}
    used = np.frombuffer(arrays["maps.pages"], np.int32)
    assert sorted(set(used)) == list(range(len(arrays["maps.field"]) // TILE**2))  # each tile is there, and in use
    assert farthest_m(recorder.online_trajectory(), log) < 0.25


def test_localization_goes_on_after_a_step_that_failed(monkeypatch):
    mcl = MonteCarloLocalization(KnownMap(flat_map()))
    drive = flat_drive(0)
    measurements = list(drive.measurements)[:60]
    reports = []

    def localize(source, **options):
        rng = np.random.default_rng(0)
        state = mcl.init_gaussian(drive.truth.poses[0], np.diag([0.01, 0.01, 0.01]), rng)
        observers = [lambda report, *_: reports.append(report)]
        run(source, mcl, rng=rng, state=state, observers=observers, **options)

    failures = []
    with monkeypatch.context() as patched:
        faults = Faults(patched, MonteCarloLocalization, "_refine_pose", range(5, 60, 7))
        localize(faults.watch(measurements), on_failure=failures.append)
    assert [failure.scan for failure in failures] == [measurements[k].scan for k in faults.hit]
    at = np.isin(drive.truth.stamps_ns, [report.stamp_ns for report in reports])
    away = between(drive.truth.poses[at], np.array([report.pose for report in reports]))
    assert np.hypot(away[:, 0], away[:, 1]).max() < 0.1


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize(("owner", "name"), PARTS, ids=[f"{owner.__name__}.{name}" for owner, name in PARTS])
def test_where_steps_fail_in_a_row_mapping_goes_on_after_them(measurements, begun, monkeypatch, owner, name, after):
    """A fault that stays, as memory that is short: nothing is lost of what was mapped, and mapping goes on after it."""
    recorder = TrajectoryRecorder()
    real = getattr(owner, name)
    is_broken = False

    def failing(*arguments, **options):
        if is_broken and not after:
            raise MemoryError
        result = real(*arguments, **options)
        if is_broken:
            raise MemoryError
        return result

    def watch():
        nonlocal is_broken
        for k, measurement in enumerate(measurements[:200]):
            is_broken = 100 <= k < 140
            yield measurement

    failures = []
    monkeypatch.setattr(owner, name, failing)
    state = run(watch(), SLAM, rng=np.random.default_rng(0), observers=[recorder], on_failure=failures.append)
    assert failures
    stamps = recorder.online_trajectory().stamps_ns
    assert set(stamps) == {m.scan.stamp_ns for m in measurements[:200]} - {failed.scan.stamp_ns for failed in failures}
    assert len(state.best_trajectory()) == recorder.keys[-1] + 1
    archive = state.closure_state.scans
    assert len(archive) == len(stamps)
    assert archive.keys == [0, *(np.flatnonzero(np.diff(recorder.keys)) + 1)]
    assert all(len(archive.key(key)) for key in range(len(archive.keys)))
    poses = recorder.best_trajectory(state).poses[:100]  # before the fault, as if it had never come
    assert np.abs(between(poses, begun)).max() < 0.5
    restored = type(state).from_arrays(state.to_arrays(), SLAM.mapper)
    assert arrays_of(restored) == arrays_of(state)
