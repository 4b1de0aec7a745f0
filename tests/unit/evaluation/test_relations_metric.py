import importlib.util
import math
from dataclasses import asdict

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.evaluation import Relations, relation_errors
from gridslam.types import Trajectory

SECOND = 1_000_000_000


def random_case(seed):
    """A trajectory with jittering stamps, and relations of which a third fall between its poses."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(200) * 200_000_000 + rng.integers(-150_000_000, 150_000_000, 200)
    poses = np.cumsum(rng.normal(0, [0.3, 0.3, 0.5], (200, 3)), axis=0)
    poses[:, 2] = (poses[:, 2] + math.pi) % (2 * math.pi) - math.pi
    given_times, other_times = rng.choice(stamps, (60, 2)), rng.integers(SECOND, 39 * SECOND, (60, 2))
    times = np.where(rng.random((60, 2)) < 0.67, given_times, other_times)
    truth = rng.uniform([-5, -5, -math.pi], [5, 5, math.pi], (60, 3))
    return Trajectory(stamps, poses), Relations(times[:, 0], times[:, 1], truth)


@pytest.mark.parametrize("seed", range(10))
def test_agrees_with_the_published_scorer(data_dir, seed):
    path = data_dir.parent / "tools" / "relations.py"
    spec = importlib.util.spec_from_file_location("relations_scorer", path)
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    scorer.round = lambda value, _digits: value  # what it computes, not what it prints
    trajectory, relations = random_case(seed)
    order = np.argsort(trajectory.stamps_ns, kind="stable")
    columns = np.zeros((len(relations.poses), 8))
    columns[:, 0], columns[:, 1] = relations.from_ns / SECOND, relations.to_ns / SECOND
    columns[:, 2:4], columns[:, 7] = relations.poses[:, :2], relations.poses[:, 2]
    expected = scorer.score(trajectory.stamps_ns[order] / SECOND, trajectory.poses[order], columns)
    got = asdict(relation_errors(trajectory, relations))
    assert list(got) == list(expected)
    assert 0.5 < got["exact"] < 0.9
    for name, value in expected.items():
        assert got[name] == pytest.approx(value, abs=1e-9), name


# From (0, 0, 0) to (1, 2, pi/2) and on to (1, 5, pi): seen from the first (1, 2, pi/2), from the second (3, 0, pi/2).
def test_numbers_by_hand():
    trajectory = Trajectory(np.arange(3) * SECOND, np.array([[0, 0, 0], [1, 2, math.pi / 2], [1, 5, -math.pi]]))
    truth = np.array([[1.3, 2.4, math.pi / 2], [3.0, -1.5, math.pi / 2 - math.radians(3)]])
    got = relation_errors(trajectory, Relations(np.array([0, 1]) * SECOND, np.array([1, 2]) * SECOND, truth))
    assert got.n == 2
    assert got.exact == 1.0
    assert [got.trans_mean_m, got.trans_std_m, got.trans_max_m] == pytest.approx([1.0, 0.5, 1.5], abs=1e-12)
    assert [got.rot_mean_deg, got.rot_std_deg, got.rot_max_deg] == pytest.approx([1.5, 1.5, 3.0], abs=1e-9)


def test_a_relation_outside_the_trajectory_raises():
    trajectory = Trajectory(np.array([0, SECOND]), np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="outside"):
        relation_errors(trajectory, Relations(np.array([0]), np.array([SECOND + 1_100_000]), np.zeros((1, 3))))
