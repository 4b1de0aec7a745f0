"""The Python interface: five lines from a log to a map, and every part that can be chosen."""

from __future__ import annotations

import ast
import io
import re
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gridslam
from gridslam import errors
from gridslam.cli.live import open_viewers
from gridslam.cli.map import map_with_progress
from gridslam.config import override
from gridslam.evaluation import absolute_errors
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import read_tum
from gridslam.localization import MonteCarloLocalization
from gridslam.particles import Residual, Systematic
from gridslam.pipeline import Stopwatch
from gridslam.types import LaserScan, OccupancyGrid, Odometry, ScanGeometry, SensorModel, Trajectory


def test_public_names_stand_in_the_stub_alone():
    stub = Path(gridslam.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    imported = [node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom)]
    names = [(alias.name, alias.asname, node.module) for node in imported for alias in node.names]
    assert all(name == seen for name, seen, _ in names)  # without "as" a stub's import is private
    assert sorted([*(name for name, _, _ in names), "__version__"]) == gridslam.__all__ == dir(gridslam)
    for name, _, module in names:
        assert getattr(gridslam, name) is getattr(import_module(module), name)


def test_documented_names_are_the_public_ones():
    text = Path(__file__).parents[2].joinpath("docs", "api.md").read_text(encoding="utf-8")
    told = set(re.findall(r":: gridslam\.(\w+)$", text, re.MULTILINE)) - {"errors"}
    assert told | {*errors.__all__, "__version__"} == set(gridslam.__all__)


def test_other_names_are_not():
    with pytest.raises(AttributeError, match="module 'gridslam' has no attribute 'map_lot'"):
        gridslam.map_lot  # noqa: B018


def test_five_lines_from_a_log_to_a_map(log, tmp_path):
    result = gridslam.map_log(log, particles=3)
    result.save(tmp_path / "out")
    assert len(result.trajectory) == len(result.online_trajectory) == 120
    assert result.trajectory.poses[-1].shape == (3,)
    assert np.hypot(*(result.trajectory.poses[-1] - result.online_trajectory.poses[-1])[:2]) < 0.1
    assert result.covariances.shape == (120, 3, 3)
    assert len(result.graph.poses) == len(result.key_stamps_ns) == result.statistics.key_scans
    assert result.loop_summary is not None
    assert result.map.known.any()
    assert result.statistics.scans == 120
    assert len(result.state.poses) == 3
    assert (tmp_path / "out" / "map.yaml").is_file()


def test_the_best_particle_alone_may_be_kept_and_the_answer_is_the_same(log):
    """The command keeps no others: the final refinement builds its own maps."""
    every, best = gridslam.map_log(log, particles=3), gridslam.map_log(log, particles=3, keep_particles=False)
    assert len(best.state.poses) == 1
    assert best.state.maps.nbytes < best.maps_bytes == every.maps_bytes == every.state.maps.nbytes
    assert best.state.poses.tobytes() == every.state.poses[every.state.best].tobytes()
    assert best.trajectory.poses.tobytes() == every.trajectory.poses.tobytes()
    assert best.map.log_odds.tobytes() == every.map.log_odds.tobytes()
    assert [*best.trajectories] == [*every.trajectories] == [drive.name for drive in every.map_piece.drives]
    assert (best.state.closure_state, best.map_piece) == (None, None)  # so that no scan is held
    with pytest.raises(errors.ArgumentError, match="one of all particles"):
        best.to_session()
    run = partial(gridslam.map_log, particles=3)
    with open_viewers(None, "log", 30.0, has_history=False) as nobody:
        mapped = map_with_progress(gridslam.CarmenLog(log), run, Stopwatch(), nobody, shown=False)
    assert len(mapped.state.poses) == 1


def test_parts_of_ones_own_map_a_log(log, tmp_path):
    @dataclass(frozen=True)
    class Counted:
        """Another measurement model, and how often it was asked."""

        model: SensorModel
        asked: list

        def __call__(self, beams):
            self.asked.append(len(beams))
            return self.model(beams)

    given = {"configuration": gridslam.Configuration(particles=3), "resampler": Residual()}
    sensor = Counted(given["configuration"].sensor, [])
    own, same = gridslam.map_log(log, **given, sensor=sensor), gridslam.map_log(log, **given)
    assert sensor.asked
    np.testing.assert_array_equal(own.trajectory.poses, same.trajectory.poses)
    assert own.save(tmp_path / "out")["own_parts"] == {"sensor": "Counted", "resampler": "Residual"}
    with pytest.raises(errors.ArgumentError, match=r"sensors: expected an argument of map_log, or a part: tracker"):
        gridslam.map_log(log, sensors=sensor)
    with pytest.raises(errors.ArgumentError, match="sensor"):
        gridslam.map_log(log, **given, sensor=3)


def test_ones_own_loop_gives_the_same(log):
    slam, rng, state, poses = gridslam.build(gridslam.preset("default", 3)), np.random.default_rng(0), None, []
    for odometry, scan in gridslam.CarmenLog(log):
        state, report = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan)
        poses.append(report.pose)
    assert np.array_equal(poses, gridslam.map_log(log, particles=3).online_trajectory.poses)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed: expected a number >= 0, got -1"),
        ({"threads": 0}, "threads: expected at least one, got 0"),
        ({"particles": 3, "configuration": gridslam.Configuration()}, "particles, laser: expected none where"),
    ],
)
def test_bad_calls_are_told(log, options, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        gridslam.map_log(log, **options)


@pytest.mark.parametrize(
    "choices",
    [
        ("tracker.kind=OdometryTracker", "resampler=wheel"),
        ("motion.kind=OdometryMotion", "resampler=stratified"),
        ("motion.kind=GMappingMotion", "when_to_resample.kind=AlwaysResample"),
        ("sensor.kind=GMappingEndPoint", "resampler=residual"),
        ("sensor.kind=LikelihoodField", "resampler=multinomial"),
        ("sensor.kind=BeamRangeFinder", "tracker.map_scans=5"),
        ("proposal.kind=MotionModelProposal", "resolution_m=0.1"),
        ("proposal.kind=ImprovedProposal", "when_to_resample.kind=NeverResample"),
        ("proposal.matcher.kind=HillClimbing",),
    ],
)
def test_every_choice_of_a_part_maps_the_log(log, choices):
    truth = read_tum(log.with_name("truth.tum"))
    result = gridslam.map_log(log, configuration=override(gridslam.preset("default", 10), *choices))
    errors = absolute_errors(result.trajectory, truth)
    # no figure of merit, but whoever is lost, or takes a sign wrong, is off by more on 12 m
    assert errors.trans_rmse_m < 0.15
    assert errors.rot_rmse_deg < 3


def test_every_call_that_reads_a_log_takes_its_path_or_the_open_log(log, simulated, tmp_path):
    truth, log = log.with_name("truth.tum"), tmp_path / "short.clf"
    write_carmen(log, simulated.measurements[:40])
    result = gridslam.map_log(log, particles=2)
    calls = {
        "map_log": lambda given: gridslam.map_log(given, particles=2).trajectory.poses,
        "map_with_poses": lambda given: gridslam.map_with_poses(given, truth).map.log_odds,
        "localize": lambda given: gridslam.localize(given, result.map, pose=np.zeros(3)).trajectory.poses,
        "diagnose": lambda given: np.array(len(gridslam.diagnose(given).findings)),
        "convert_log": lambda given: np.array(gridslam.convert_log(given, tmp_path / "out.csv").scans),
    }
    for name, call in calls.items():
        first, *others = (call(given) for given in (str(log), log, gridslam.open_log(log)))
        assert all(np.array_equal(first, other) for other in others), name
        with pytest.raises(gridslam.ArgumentError, match="log: expected str, Path or a log as open_log"):
            call(7)
        with pytest.raises(gridslam.InputError, match="no such file"):
            call("nothing.clf")


@pytest.mark.parametrize("read", [gridslam.map_landmarks, gridslam.localize_by_landmarks])
def test_what_is_no_log_of_landmarks_is_told(read):
    with pytest.raises(gridslam.ArgumentError, match="log: expected str, Path or a log as open_landmark_log gives it"):
        read(7)


GEOMETRY = ScanGeometry(np.linspace(-1.0, 1.0, 5))
RANGES, STATUS = np.full(5, 2.0), np.zeros(5, np.uint8)
SCAN = LaserScan.from_ranges(0, RANGES, GEOMETRY)
ODOMETRY = Odometry.at(0, (0.0, 0.0, 0.0))
SLAM = gridslam.GridFastSlam(particles=2)
WEIGHTS = np.full(4, 0.25)


def room() -> OccupancyGrid:
    """A box of walls about free space."""
    odds = np.full((20, 20), -3.0, np.float32)
    odds[0] = odds[-1] = odds[:, 0] = odds[:, -1] = 3.0
    return OccupancyGrid(odds, np.ones(odds.shape, bool), 0.1, (-1.0, -1.0))


MCL = MonteCarloLocalization(gridslam.KnownMap(room()))


@pytest.mark.parametrize("seed", [0, None, "rng"])
def test_a_seed_is_no_generator(seed):
    for call in (
        lambda: gridslam.run([(ODOMETRY, SCAN)], SLAM, rng=seed),
        lambda: SLAM.step(SLAM.init(ODOMETRY, SCAN)[0], ODOMETRY, SCAN, seed),
        lambda: MCL.step(MCL.init(), ODOMETRY, SCAN, seed),
        lambda: Systematic()(WEIGHTS, 4, seed),
    ):
        with pytest.raises(
            gridslam.ArgumentError, match=rf"rng: expected a numpy\.random\.Generator, .*, got {seed!r}"
        ):
            call()


def test_a_refused_call_does_not_consume_the_state():
    state, _ = SLAM.init(ODOMETRY, SCAN)
    for arguments in ((ODOMETRY, SCAN, 0), (SCAN, ODOMETRY, np.random.default_rng(0))):
        with pytest.raises(gridslam.ArgumentError):
            SLAM.step(state, *arguments)
    SLAM.step(state, ODOMETRY, SCAN, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: SLAM.init(SCAN, ODOMETRY), "odometry: expected Odometry or None, got a LaserScan"),
        (lambda: SLAM.init(ODOMETRY, ODOMETRY), "scan: expected LaserScan, got a Odometry"),
        (lambda: SLAM.init(ODOMETRY, SCAN, "all"), "particles: expected a number, or finite poses of shape"),
        (lambda: SLAM.init(ODOMETRY, SCAN, 2.5), "particles: expected a number, or finite poses of shape"),
        (lambda: SLAM.init(ODOMETRY, SCAN, (0.0, 0.0, 0.0), 30), "particles: expected a number, or finite poses"),
        (lambda: SLAM.init(ODOMETRY, SCAN, 2, "here"), "pose: expected"),
        (lambda: SLAM.step(SCAN, ODOMETRY, SCAN, RNG), "state: expected GridFastSlamState, got a LaserScan"),
        (lambda: SLAM.step(SLAM.init(None, SCAN), ODOMETRY, SCAN, RNG), "state: expected GridFastSlamState, got a tu"),
        (lambda: MCL.step(MCL.init(), SCAN, ODOMETRY, RNG), "odometry: expected Odometry or None, got a LaserScan"),
        (lambda: gridslam.run("intel.clf.bz2", SLAM, rng=RNG), r"source: expected measurements.*got 'intel.clf.bz2'"),
        (lambda: gridslam.run(7, SLAM, rng=RNG), r"source: expected measurements.*got 7"),
        (lambda: gridslam.run([SCAN], SLAM, rng=RNG), r"source: expected measurements.*got a LaserScan"),
        (lambda: gridslam.map_log("a.clf", repair="some"), "repair: expected needed or none, got some"),
    ],
)
def test_arguments_of_other_kinds_are_told(call, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        call()


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LaserScan(0, RANGES[:4], STATUS, GEOMETRY), r"ranges: expected shape \(5,\), got \(4,\)"),
        (lambda: LaserScan(0, RANGES, STATUS[:4], GEOMETRY), r"status: expected shape \(5,\), got \(4,\)"),
        (lambda: LaserScan(0, RANGES, np.full(5, 3, np.uint8), GEOMETRY), "status: expected values of BeamStatus"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, -1.0), "range_min_m: expected a finite number >= 0, got -1"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, np.nan), "range_min_m: expected a finite number >= 0, got nan"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, 1.0, -2.0), "range_max_m: expected a number > range_min_m, 1,"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, 0.0, np.nan), "range_max_m: expected a number > range_min_m"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, beam_times_s=RANGES[:1]), "beam_times_s: expected shape"),
        (lambda: LaserScan.from_ranges(0, RANGES, GEOMETRY, range_min_m=-0.1), "range_min_m: expected a finite"),
        (lambda: LaserScan.from_ranges(0, [[1.0]], GEOMETRY), r"ranges: expected shape \(5,\)"),
        (lambda: ScanGeometry([0.0, np.nan]), "bearings: expected finite angles in rad"),
        (lambda: ScanGeometry([0.0], np.full((4, 4), np.nan)), "base_from_laser: expected finite numbers"),
        (lambda: ScanGeometry([0.0], np.diag([1.0, 1.0, 1.0, np.nan])), "base_from_laser: expected finite numbers"),
        (lambda: ScanGeometry.planar([0.0], (0.0, 0.0)), r"base_from_laser: expected shape \(3,\)"),
        (lambda: Odometry(0, np.array([0.0, np.inf, 0.0])), "pose: expected finite x, y, theta"),
        (lambda: Trajectory(np.array([0]), np.zeros((1, 2))), r"poses: expected shape \(1, 3\)"),
        (lambda: OccupancyGrid(np.zeros((2, 2)), np.ones((2, 3), bool), 0.1, (0, 0)), "known: expected shape"),
        (lambda: OccupancyGrid(np.zeros((2, 2)), np.ones((2, 2), bool), 0.0, (0, 0)), "resolution_m: expected a fini"),
    ],
)
def test_values_that_contradict_themselves_are_refused(make, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        make()


@pytest.fixture(scope="module")
def mapped(log):
    return gridslam.map_log(log, particles=2)


@pytest.fixture(scope="module")
def results(log, mapped, park, tmp_path_factory):
    folder = tmp_path_factory.mktemp("landmarks")
    landmarks = gridslam.map_landmarks(park[0], "ekf")
    landmarks.save(folder / "out")
    return {
        "MapResult": mapped,
        "LocalizationResult": gridslam.localize(log, mapped.map, pose=np.zeros(3)),
        "GridResult": gridslam.map_with_poses(log, mapped.trajectory),
        "LandmarkResult": landmarks,
        "LandmarkLocalizationResult": gridslam.localize_by_landmarks(park[0], folder / "out" / "landmarks.csv"),
    }


def empty_grid(shape=(0, 0)):
    return gridslam.OccupancyGrid(np.zeros(shape, np.float32), np.zeros(shape, bool), 0.05, (0.0, 0.0))


def test_a_grid_is_shown_as_map_files_have_it(mapped):
    grid = mapped.map
    pixels = np.asarray(Image.open(io.BytesIO(grid._repr_png_())))
    assert pixels.shape == grid.known.shape
    assert ((pixels == 205) == ~grid.known[::-1]).all()
    assert ((pixels < 100) <= (grid.log_odds > 0)[::-1]).all()
    assert (pixels[(grid.log_odds > 2)[::-1] & grid.known[::-1]] < 50).all()
    large = empty_grid((5, 3001))
    large.known[2, 1500] = True
    large.log_odds[2, 1500] = 5.0
    shrunk = np.asarray(Image.open(io.BytesIO(large._repr_png_())))
    assert max(shrunk.shape) <= 1000
    assert (shrunk < 50).any()  # a wall of one cell is still there
    assert empty_grid()._repr_png_() is None
