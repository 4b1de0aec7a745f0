"""The Python interface: five lines from a log to a map, and every part that can be chosen."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import gridslam
from gridslam import errors
from gridslam.cli.map import map_with_progress
from gridslam.config import override
from gridslam.evaluation import absolute_errors
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import read_tum
from gridslam.particles import Residual
from gridslam.pipeline import Stopwatch
from gridslam.types import SensorModel


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
    assert len(map_with_progress(gridslam.CarmenLog(log), run, Stopwatch(), shown=False).state.poses) == 1


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
