"""Pose graphs: chi2 and time of gridslam's optimizer beside GTSAM's, each the best of several turns, taken in turn.

python benchmarks/graphs.py [--data ../shared/data] [--repeats 7]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gridslam.io.g2o import read_g2o
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity
from report import Report, Target, table

LEAST_CHI2 = {"m3500": 137.912951, "intel": 45.004696, "intel_1228": 215.830235, "ring": 11.163101}
"""The least sums of e' information e that are known, with g2o's error."""


class Solver(NamedTuple):
    """A way to solve a graph: what is prepared without being timed, and what is timed; it returns poses (N, 3)."""

    name: str
    prepare: Callable[[PoseGraph], Any]
    solve: Callable[[Any], Any]
    poses: Callable[[Any], np.ndarray]


def graphs(data: Path, report: Report, repeats: int = 7) -> None:
    """Measure the graphs there are and add a section and targets to the report."""
    rows = []
    for name, least in LEAST_CHI2.items():
        path = data / "graphs" / f"{name}.g2o.gz"
        if not path.is_file():
            continue
        graph = read_g2o(path).graph
        best = {solver.name: (1e3 * seconds, chi2) for solver, seconds, chi2 in _timed(graph, repeats)}
        rows += [
            [name, len(graph.poses), solver, f"{chi2:.6f}", milliseconds]
            for solver, (milliseconds, chi2) in best.items()
        ]
        rows.append([name, len(graph.poses), "gridslam, all covariances", "", 1e3 * _covariances_s(graph)])
        ours, chi2 = best["gridslam"]
        report.targets.append(Target(f"{name}: chi2", chi2, least * (1 + 1e-6)))
        peers = [time for solver, (time, reached) in best.items() if "GTSAM" in solver and reached < 1.01 * least]
        if name == "m3500" and peers:
            report.targets.append(
                Target(f"{name}: time to solve", ours, min(peers), f"GTSAM {min(peers):.0f}", "", "ms")
            )
    if rows:
        report.add(f"Pose graphs: best of {repeats}", table(["graph", "poses", "solver", "chi2", "ms"], rows))


def _timed(graph: PoseGraph, repeats: int) -> Iterator[tuple[Solver, float, float]]:
    """Each solver's least time and its chi2; all take turns, so that a busy moment strikes none alone."""
    solvers = [*_make_writable(), *_gtsam()]
    seconds, chi2 = np.full(len(solvers), np.inf), np.full(len(solvers), np.nan)
    for _ in range(repeats):
        for k, solver in enumerate(solvers):
            prepared = solver.prepare(graph)
            begin = time.perf_counter()
            try:
                found = solver.solve(prepared)
            except RuntimeError:  # GTSAM: the linear system is indeterminate
                continue
            seconds[k] = min(seconds[k], time.perf_counter() - begin)
            chi2[k] = graph.chi2(solver.poses(found))
    yield from zip(solvers, seconds.tolist(), chi2.tolist(), strict=True)


def _make_writable() -> Iterator[Solver]:
    variants = {
        "gridslam": GraphSlam(),
        "gridslam, from the file's guess": GraphSlam(first_guess="given"),
        "gridslam, without a guess": GraphSlam(first_guess="computed"),
        "gridslam, robust": GraphSlam(robust=GraduatedNonConvexity()),
    }
    for name, slam in variants.items():
        yield Solver(name, lambda graph: graph, slam.solve, lambda found: found.poses)
    solve_again = GraphSlam(first_guess="given").solve
    yield Solver(
        "gridslam, solved again", lambda graph: GraphSlam().solve(graph).graph, solve_again, lambda found: found.poses
    )


def _gtsam() -> Iterator[Solver]:
    """GTSAM's two optimizers, where it is installed; building its factors is not timed."""
    try:
        import gtsam
    except ImportError:
        return

    def build(graph: PoseGraph) -> tuple[Any, Any]:
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for place, pose in enumerate(graph.poses):
            values.insert(place, gtsam.Pose2(*pose))
        for (first, second), z, omega in zip(graph.edges.tolist(), graph.measurements, graph.information, strict=True):
            noise = gtsam.noiseModel.Gaussian.Information(omega)
            factors.add(gtsam.BetweenFactorPose2(first, second, gtsam.Pose2(*z), noise))
        held = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
        factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), held))
        return factors, values

    def poses(values: Any) -> np.ndarray:  # noqa: ANN401
        return np.array([[(p := values.atPose2(k)).x(), p.y(), p.theta()] for k in range(values.size())])

    for kind in ("GaussNewton", "LevenbergMarquardt"):
        optimizer = getattr(gtsam, f"{kind}Optimizer")
        yield Solver(f"GTSAM, {kind}", build, lambda built, optimizer=optimizer: optimizer(*built).optimize(), poses)


def _covariances_s(graph: PoseGraph) -> float:
    solved = GraphSlam().solve(graph).graph
    begin = time.perf_counter()
    marginal_covariances(solved)
    return time.perf_counter() - begin


def main() -> None:
    """Print the section and the targets."""
    parser = argparse.ArgumentParser(description="Time and chi2 of the graph optimizer, beside GTSAM's.")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=beside, help="folder of real data")
    parser.add_argument("--repeats", type=int, default=7, help="turns of which the best counts")
    given = parser.parse_args()
    report = Report()
    graphs(given.data, report, given.repeats)
    print(f"\n{report.summary()}")


if __name__ == "__main__":
    main()
