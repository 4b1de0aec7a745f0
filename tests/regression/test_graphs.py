"""The four real graphs: the least chi2 that is known, from any guess, and in spite of false closures."""

import numpy as np
import pytest

from gridslam.io.g2o import read_g2o
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity
from support.random_graphs import with_false_closures

CHI2 = {"intel": 45.004696, "intel_1228": 215.830235, "m3500": 137.912951, "ring": 11.163101}


@pytest.fixture(scope="module")
def graphs(data_dir):
    return {name: read_g2o(data_dir / "graphs" / f"{name}.g2o.gz").graph for name in CHI2}


@pytest.mark.parametrize("first_guess", ["either", "given", "computed"])
@pytest.mark.parametrize("name", CHI2)
def test_the_least_chi2_known_is_reached(graphs, name, first_guess):
    solution = GraphSlam(first_guess=first_guess).solve(graphs[name])
    assert solution.converged
    assert solution.chi2_after == pytest.approx(CHI2[name], rel=1e-7)
    assert solution.iterations <= 8
    again = GraphSlam(first_guess="given").solve(solution.graph)
    assert again.iterations == 1
    assert again.chi2_after == pytest.approx(CHI2[name], rel=1e-7)


@pytest.mark.parametrize("name", CHI2)
def test_it_is_reached_from_poses_that_mean_nothing(graphs, name):
    graph = graphs[name]
    poses = np.random.default_rng(0).uniform((-50, -50, -np.pi), (50, 50, np.pi), graph.poses.shape)
    poses[0] = graph.poses[0]
    assert GraphSlam().solve(graph.with_poses(poses)).chi2_after == pytest.approx(CHI2[name], rel=1e-7)


def contaminated(graph, seed):
    """The graph about its own guess with ten percent of false closures, and which are false."""
    solved = GraphSlam().solve(graph).graph
    more, false = with_false_closures(solved, 0.1, np.random.default_rng(seed))
    return more.with_poses(graph.poses), false


@pytest.mark.parametrize("first_guess", ["either", "computed"])
@pytest.mark.parametrize(("name", "seeds"), [("ring", range(5)), ("intel", (0,)), ("m3500", (0,))])
def test_the_truth_is_found_among_ten_percent_of_false_closures(graphs, name, seeds, first_guess):
    for seed in seeds:
        graph, false = contaminated(graphs[name], seed)
        solution = GraphSlam(first_guess=first_guess, robust=GraduatedNonConvexity()).solve(graph)
        assert solution.weights.tolist() == (~false).astype(float).tolist()
        assert solution.chi2_after == pytest.approx(CHI2[name], rel=1e-6)


def test_without_robust_estimation_false_closures_ruin_it(graphs):
    graph, _ = contaminated(graphs["ring"], 0)
    assert GraphSlam().solve(graph).chi2_after > 10 * CHI2["ring"]
