"""The last word: no worse than the filter's trajectory, and just what was tracked where nothing ties it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import hall
import numpy as np
import pytest
from loops import loop_drive

from gridslam.evaluation import absolute_errors
from gridslam.geometry.se2 import between
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import OdometryNoise, SimulatedLog
from gridslam.slam import GridFastSlam
from gridslam.slam.full_trajectory import full_trajectory
from gridslam.slam.joint_matching import JointMatching, LastWord
from gridslam.slam.loop_closure import LoopClosure
from gridslam.slam.memory import Memory
from gridslam.slam.state import GridFastSlamState
from gridslam.slam.submaps import drawn
from gridslam.types import Trajectory

CLOSURE = LoopClosure()
SLAM = GridFastSlam(loop_closure=CLOSURE)
WORD = JointMatching()


@dataclass(frozen=True)
class Told:
    """A run, and the last word on it."""

    log: SimulatedLog
    state: GridFastSlamState
    recorder: TrajectoryRecorder
    memory: Memory
    word: LastWord


def told(log: SimulatedLog, scans: int | None = None, word: JointMatching = WORD, tick=lambda: None) -> Told:
    recorder = TrajectoryRecorder()
    state = run(log.measurements[:scans], SLAM, particles=3, rng=np.random.default_rng(1), observers=[recorder])
    memory = state.memory.snapshot()
    trajectory = state.ancestry.trajectory(state.best)
    said = word(memory, trajectory, recorder.keys, recorder.from_key, SLAM.mapper, CLOSURE, tick)
    return Told(log, state, recorder, memory, said)


@pytest.fixture(scope="module")
def halls() -> list[Told]:
    poor = OdometryNoise(distance_scale=1.03, turn_scale=0.95, bias_rad_per_m=0.01)
    return [told(hall.drive(seed, poor)) for seed in (0, 2)]


@pytest.fixture(scope="module")
def loop() -> Told:
    return told(loop_drive())


@pytest.fixture(scope="module")
def untied() -> Told:
    """The first half of a lap: no place is passed twice, and none is seen from far away in time."""
    return told(hall.drive(0), scans=110)


def errors(run: Told, poses: np.ndarray):
    truth = Trajectory(run.log.truth.stamps_ns, between(run.log.truth.poses[0], run.log.truth.poses))
    return absolute_errors(Trajectory(truth.stamps_ns, poses), truth)


def test_the_last_word_is_no_worse_than_the_filter(halls, loop):
    """By a centimetre, a fifth of a cell, at most; where the filter is off by most of a cell, it is better.

    Over all scans, aligned.
    """
    for one in (*halls, loop):
        filtered, said = errors(one, one.recorder.best_trajectory(one.state).poses), errors(one, one.word.poses)
        assert said.trans_rmse_m < filtered.trans_rmse_m + 0.01
        assert said.rot_rmse_deg < filtered.rot_rmse_deg + 0.1
        assert said.trans_rmse_m < 0.07
        assert one is loop or said.trans_rmse_m < max(filtered.trans_rmse_m, 0.04)
        assert len(one.word.best.graph.edges) > len(one.word.best.graph.poses)  # it was tied


def test_ties_of_the_last_word_are_right(halls, loop):
    for one in (*halls, loop):
        truth = one.log.truth.poses[one.state.memory.scans.keys]
        assert len(one.word.best.ties) > 50
        off = hall.errors(truth, [tie for tie in one.word.best.ties if tie.determined])
        assert np.quantile(off[:, 0], 0.95) < 0.1
        assert off[:, 0].max() < 0.5
        assert off[:, 1].max() < 0.05


def test_it_says_what_it_solved(halls):
    """The graph holds the solution, a weight for each edge, ties to other times only; the map is drawn from it."""
    one = halls[0]
    graph, weights = one.word.best.graph, one.word.best.weights
    keys = len(one.memory.graph)
    assert graph.poses.shape == (keys, 3)
    assert weights.shape == (len(graph.edges),)
    assert ((weights >= 0) & (weights <= 1)).all()
    ties = graph.edges[keys - 1 :]
    assert (np.abs(ties[:, 0] - ties[:, 1]) > 20).all()
    np.testing.assert_array_equal(graph.poses, np.array(one.memory.graph.poses))
    maps = drawn(SLAM.mapper, one.memory.scans, np.arange(keys), graph.poses)
    assert maps.occupancy(0).log_odds.tobytes() == one.word.maps.occupancy(0).log_odds.tobytes()


def test_no_scan_is_moved_farther_from_the_key_scans_trajectory_than_allowed(halls):
    one = halls[0]
    bent = full_trajectory(one.word.best.graph.poses, one.recorder.keys, one.recorder.from_key)
    moved = np.hypot(*(one.word.poses - bent)[:, :2].T)
    assert moved.max() <= WORD.scan_m
    assert 0 < np.median(moved) < 0.05


def test_without_a_tie_the_key_scans_stay_on_the_chain(untied):
    """From each key scan to the next as the filter has it, or as tracked: nothing else is known."""
    graph, state = untied.word.best.graph, untied.state
    assert untied.word.best.ties == []
    assert len(graph.edges) == len(graph.poses) - 1
    assert (untied.word.best.weights == 1).all()
    assert graph.chi2() < 1e-6
    said, filtered, tracked = (
        between(poses[:-1], poses[1:])
        for poses in (graph.poses, state.ancestry.trajectory(state.best), np.array(state.memory.graph.tracked))
    )
    as_filtered, as_tracked = (np.abs(between(said, other)).max(axis=1) < 1e-6 for other in (filtered, tracked))
    assert (as_filtered | as_tracked).all()


def test_the_run_may_go_on_as_if_nothing_had_been_said(untied):
    """The last word was given a snapshot of the memory: of what it did nothing is in the state."""
    before = {name: array.tobytes() for name, array in untied.state.to_arrays().items()}
    memory = untied.state.memory.snapshot()
    moved = untied.state.ancestry.trajectory(untied.state.best) + np.array([1.0, 2.0, 0.0])
    WORD(memory, moved, untied.recorder.keys, untied.recorder.from_key, SLAM.mapper, CLOSURE)
    assert {name: array.tobytes() for name, array in untied.state.to_arrays().items()} == before


def test_the_same_word_is_said_twice(halls):
    again = told(halls[0].log)
    assert again.word.poses.tobytes() == halls[0].word.poses.tobytes()
    assert again.word.best.graph.poses.tobytes() == halls[0].word.best.graph.poses.tobytes()
    assert again.word.best.weights.tobytes() == halls[0].word.best.weights.tobytes()


def test_a_round_that_moves_nothing_is_the_last(halls):
    """Counted by the submaps that are drawn: one tick for each, and each round draws the same ones here."""
    ticks = []
    for rounds in (1, 4):
        word, count = replace(WORD, rounds=rounds, stop_m=1.0), []
        told(halls[0].log, word=word, tick=lambda count=count: count.append(1))
        ticks.append(len(count))
    assert ticks[0] == ticks[1] > 5


def test_it_can_be_interrupted(halls):
    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        told(halls[0].log, tick=stop)
