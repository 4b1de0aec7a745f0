"""Do covariances mean something? Average NEES against simulated truth, online and final, in eight kinds of worlds.

    python benchmarks/covariances.py [KIND|LOG ...] [--seeds 20] [--first 101]
        [--set NAME=VALUE ...] [--out FILE]

Each drive is mapped with the defaults. NEES is taken of every pose after the first tenth of the drive, in the frame of
the first pose, which is given; its expectation is 3, and 95 of 100 should lie below 7.81. The parameters of the
covariances were set on the seeds 1 to 12, and the scale of the map on a campus, too.

Measurements between key scans are judged, too, by what the rest of the graph predicts for every tenth that is left out,
in ten folds; this needs no truth, so that it is all there is of a log. An increment is left out alone. Constraints are
left out by visits, whose errors they share: each is then as certain as if it were the only one of its visit.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from aliasing_worlds import make_world
from closure_worlds import campus
from gridslam.config import Configuration, override
from gridslam.evaluation import nees
from gridslam.geometry.se2 import between
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, simulate
from gridslam.slam.full_slam.full_slam import FullSlam
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.marginals import Marginals
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import Odometry
from measure import write_document
from simulated import map_drive

WORLDS = {
    "random": ("random", 30.0),
    "rooms": ("rooms", 30.0),
    "loop": ("loop", 30.0),
    "bare_corridors": ("bare_corridors", 30.0),
    "bare_corridors_10m": ("bare_corridors", 10.0),
    "halls": ("hall", 30.0),
    "equal_rooms": ("equal_rooms", 30.0),
    "sparse": ("random", 30.0),
}
"""World and the laser's range by kind; "campus" is another one."""

KEY_SCAN_M = 1.0
KEY_SCAN_RAD = 0.5
"""What lies between two scans of a sparse drive."""

QUANTILE = 7.8147
FOLDS = 10


def simulated(kind: str, seed: int) -> tuple[list[Measurement], np.ndarray]:
    """Measurements of a drive, and true poses (N, 3)."""
    if kind == "campus":
        stream = campus(seed).stream()
        scans = [measurement.scan for measurement in stream.measurements]
        odometry = stream.odometry.poses
        paired = zip(scans, odometry, strict=True)
        return [Measurement(Odometry.at(scan.stamp_ns, pose), scan) for scan, pose in paired], stream.truth.poses
    world, range_m = WORLDS[kind]
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    lidar = LidarConfig(range_max_m=range_m)
    log = simulate(make_world(world, np.random.default_rng(seed)), RobotConfig(), OdometryNoise(), lidar, rng)
    measurements = list(log.measurements)
    truth = log.truth.poses
    if kind != "sparse":
        return measurements, truth
    kept = thin(truth)
    return [measurements[k] for k in kept], truth[kept]


def thin(poses: np.ndarray, metres: float = KEY_SCAN_M, radians: float = KEY_SCAN_RAD) -> list[int]:
    """Places of poses (N, 3) each of which is so far from the one before."""
    kept = [0]
    for k in range(len(poses)):
        dx, dy, turn = between(poses[kept[-1]], poses[k])
        if np.hypot(dx, dy) >= metres or abs(turn) >= radians:
            kept.append(k)
    return kept


def judge(kind: str, seed: int, configuration: Configuration | None = None) -> dict[str, Any]:
    """Map one drive; average NEES and percentage below the quantile, online and final, and of constraints left out."""
    measurements, truth = simulated(kind, seed)
    reports, full = map_drive(measurements, configuration or Configuration(), seed)
    true = between(truth[0], truth)
    judged = slice(len(true) // 10, None)
    poses = np.array([report.pose for report in reports])
    covariances = np.array([report.covariance for report in reports])
    squares = {
        "online": nees(poses[judged], true[judged], covariances[judged]),
        "final": nees(full.poses[judged], true[judged], full.covariances[judged]),
    }
    found: dict[str, Any] = {"kind": kind, "seed": seed}
    for name, of in squares.items():
        found |= {f"{name}_nees": float(of.mean()), f"{name}_inside": float(100 * (of < QUANTILE).mean())}
    found["rmse_m"] = float(np.sqrt(np.square((full.poses - true)[:, :2]).sum(axis=1).mean()))
    return found | left_out(full)


def judge_log(path: str, seed: int) -> dict[str, Any]:
    """Map a log, whose truth is not known; NEES over its expectation of measurements left out."""
    _, full = map_drive(open_log(path), Configuration(), seed)
    return {"kind": Path(path).name, "seed": seed} | left_out(full)


def left_out(full: FullSlam) -> dict[str, float]:
    """NEES over its expectation of increments, and of constraints by visits, left out of a solved graph by turns."""
    graph = full.graph
    groups = {"increments": [[edge] for edge in range(len(graph.poses) - 1)], "constraints": group_by_visits(full)}
    ratios = {}
    for name, members in groups.items():
        squares = []
        for fold in range(FOLDS if len(members) >= FOLDS else 0):
            chosen = choose_removable(graph, members[fold::FOLDS])
            if not chosen:
                continue
            out = np.concatenate(chosen)
            shared_by = np.concatenate([np.full(len(group), len(group)) for group in chosen])
            kept = np.setdiff1d(np.arange(len(graph.edges)), out)
            rest = PoseGraph.of(
                graph.poses, graph.edges[kept], graph.measurements[kept], graph.information[kept], graph.trusted[kept]
            )
            rest = rest.with_poses(GraphSlam(first_guess="given").solve(rest).poses)
            found = Marginals(rest).squared_innovations(
                graph.edges[out], graph.measurements[out], graph.information[out] * shared_by[:, None, None]
            )
            squares.append(found)
        if squares:
            ratios[f"left_out_{name}"] = float(np.concatenate(squares).mean() / 3)
    return ratios


def group_by_visits(full: FullSlam) -> list[list[int]]:
    """Places of the constraints in the graph, those of a key scan that share the information of its points joined.

    Recognized places share none.
    """
    assert full.loop_summary is not None
    edges = full.graph.edges.tolist()
    matched = len(edges) - full.loop_summary.refinement_constraints
    visits = [[edge] for edge in range(len(full.graph.poses) - 1, matched)]
    for edge in range(matched, len(edges)):
        if edge > matched and edges[edge][1] == edges[edge - 1][1]:
            visits[-1].append(edge)
        else:
            visits.append([edge])
    return visits


def choose_removable(graph: PoseGraph, groups: list[list[int]]) -> list[list[int]]:
    """Groups of measurements that can be left out together, the others still joining all poses."""
    chosen: list[list[int]] = []
    for group in groups:
        if is_connected_without(graph, [edge for other in (*chosen, group) for edge in other]):
            chosen.append(group)
    return chosen


def is_connected_without(graph: PoseGraph, out: list[int]) -> bool:
    """Whether the measurements join all poses without those at places `out`."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    kept = np.delete(graph.edges, out, axis=0)
    count = len(graph.poses)
    joined = coo_array((np.ones(len(kept)), (kept[:, 0], kept[:, 1])), shape=(count, count))
    return bool(connected_components(joined, directed=False)[0] == 1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each kind, and write all drives."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(WORLDS)} [all of them], campus, a log")
    parser.add_argument("--seeds", type=int, default=20, help="drives of each kind [20]")
    parser.add_argument("--first", type=int, default=101, help="first seed [101]")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="of the simulated drives")
    given = parser.parse_args(arguments)
    configuration = override(Configuration(), *given.set)
    columns = "online_nees", "online_inside", "final_nees", "final_inside", "rmse_m"
    columns += "left_out_increments", "left_out_constraints"
    table = ["| kind | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    print(*table, sep="\n")
    drives = []
    for kind in given.kinds or WORLDS:
        seeds = range(given.first, given.first + given.seeds)
        of_kind = [judge_log(kind, seed) if Path(kind).exists() else judge(kind, seed, configuration) for seed in seeds]
        drives += of_kind
        values = [[drive[name] for drive in of_kind if name in drive] for name in columns]
        means = [np.mean(of_column) if of_column else np.nan for of_column in values]
        table.append(f"| {of_kind[0]['kind']} | " + " | ".join(f"{mean:.3g}" for mean in means) + " |")
        print(table[-1], flush=True)
    if given.out is not None:
        how = f"simulated drives, seeds {given.first} to {given.first + given.seeds - 1}"
        how += "".join(f", {assignment}" for assignment in given.set)
        write_document(given.out, how, table=table, drives=drives)


if __name__ == "__main__":
    main()
