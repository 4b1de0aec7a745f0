"""Does the self-consistency score rank trajectories as their errors do? Thirty configurations, from good to spoiled.

The score and its prior were chosen in the simulated buildings of seeds 1 to 4; the others and the real logs are the
test. Beside it stand other scores of the literature, on the same trajectories; and what each makes of trajectories that
are wrong in ways that a score must not reward.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.api.mapping import map_log
from gridslam.config import Configuration, override
from gridslam.evaluation.self_consistency import sample_evenly, score_drawn_scans
from gridslam.evaluation.trajectory import Relations, absolute_errors, associate, clip_relations, relation_errors
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.log import LogOptions, open_log
from gridslam.io.trajectories import read_relations, read_tum
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import Beams, FloatArray, IntArray, Trajectory
from measure import write_document

__all__ = ["SHIPPED", "Drive", "draw_configurations", "draw_relations", "main", "rank_correlation"]

SHIPPED = "self-consistency"
_CONFIGURATIONS = 30
_WORLDS = range(1, 7)  # seeds; the score was chosen in the first four
_RELATIONS = 1500  # of places near each other, and as many of scans shortly after each other
_NEAR_M = 2.0
_SCANS_APART = 4
_VISIT_M = 8.0  # of way (m + rad) that count as one visit, for the scores that compare visits
_WORST: Mapping[str, tuple[float, ...]] = {
    "beam_sigma_m": (0.05,),
    "insert_m": (0.02, 3.0),
    "key_scan_m": (4.0,),
    "resolution_m": (0.5,),
    "range_max_m": (2.5,),
    "noise_m": (0.001, 0.3),
    "noise_rad": (0.0005, 0.2),
    "tempering": (0.001, 1.0),
    "tracker.matcher.cauchy_m": (0.01, 2.0),
}
_DEFAULT = {
    "beam_sigma_m": 0.0016,
    "insert_m": 0.2,
    "key_scan_m": 0.5,
    "resolution_m": 0.05,
    "range_max_m": 30.0,
    "noise_m": 0.02,
    "noise_rad": 0.01,
    "tempering": 0.03,
    "tracker.matcher.cauchy_m": 0.1,
}
_OF_TRACKER = "beam_sigma_m", "insert_m", "tracker."


@final
class Drive(NamedTuple):
    """A log, what is read of it, and what is true of it: relations, or a path that they are drawn from."""

    name: str
    log: Path
    options: LogOptions
    truth: Relations | Trajectory


def draw_configurations(count: int = _CONFIGURATIONS) -> list[list[str]]:
    """Assignments of each configuration; the first is the default, and each is more spoiled than the one before."""
    rng = np.random.default_rng(1)
    drawn: list[list[str]] = [[]]
    for k in range(1, count):
        spoiled = k / (count - 1)
        names = sorted(rng.choice(list(_WORST), int(rng.integers(1, 5)), replace=False))
        chosen = []
        for name in names:
            ratio = float(rng.choice(_WORST[name])) / _DEFAULT[name]
            chosen.append(f"{name}={_DEFAULT[name] * ratio ** (spoiled * rng.uniform(0.3, 1.0)):.4g}")
        chosen.append(f"particles={int(rng.choice([3, 10, 30]))}")
        if rng.random() < 0.2 + 0.6 * spoiled:
            chosen.append("loop_closure=false")
        if rng.random() < 0.6 * spoiled:
            chosen = [*(one for one in chosen if not one.startswith(_OF_TRACKER)), "tracker.kind=OdometryTracker"]
        drawn.append(chosen)
    return drawn


def draw_relations(truth: Trajectory) -> Relations:
    """Relations of a true path, in the manner of those of Intel and ACES: near each other in space, or in time."""
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, len(truth), (2, 400_000))
    apart = np.hypot(*(truth.poses[pairs[0], :2] - truth.poses[pairs[1], :2]).T)
    near = pairs[:, (apart < _NEAR_M) & (pairs[0] < pairs[1])][:, :_RELATIONS]
    first = rng.integers(0, len(truth) - _SCANS_APART - 1, _RELATIONS)
    one, other = np.concatenate([near, [first, first + _SCANS_APART]], axis=1)
    poses = between(truth.poses[one], truth.poses[other])
    return Relations(truth.stamps_ns[one], truth.stamps_ns[other], poses)


def rank_correlation(scores: Sequence[float], errors: Sequence[float]) -> tuple[float, float, float]:
    """Spearman's coefficient, and its 95 % interval by 2000 draws of the configurations."""
    from scipy.stats import spearmanr

    pairs = np.array([scores, errors])
    rng = np.random.default_rng(0)
    drawn = [spearmanr(*pairs[:, rng.integers(0, pairs.shape[1], pairs.shape[1])])[0] for _ in range(2000)]
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return float(spearmanr(*pairs)[0]), float(low), float(high)


def _real_drives(data: Path) -> list[Drive]:
    log = data / "sparse" / "freiburg-101.clf.gz"
    path = read_tum(data / "sparse" / "freiburg-101.ref.tum.gz")
    return [
        Drive("intel", data / "intel.clf.bz2", LogOptions(every=4), read_relations(data / "intel.relations")),
        Drive("aces", data / "aces.clf.bz2", LogOptions(every=3), read_relations(data / "aces.relations")),
        Drive("freiburg", log, LogOptions(), path),
        Drive("freiburg-every2", log, LogOptions(every=2), path),
    ]


def _simulated_drive(seed: int, folder: Path) -> Drive:
    rng = np.random.default_rng(seed)
    run = simulate(make_world("random", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
    path = folder / f"world{seed}.clf"
    write_carmen(path, run.measurements)
    return Drive(f"world{seed}", path, LogOptions(every=2), run.truth)


def _map_all(drive: Drive, folder: Path) -> list[Trajectory]:
    """Trajectories of all configurations; those that are in the folder are not made again."""
    found = []
    for k, assignments in enumerate(draw_configurations()):
        path = folder / f"{drive.name}-{k}.npz"
        if not path.exists():
            configuration = override(Configuration(), *assignments)
            trajectory = map_log(drive.log, configuration=configuration, options=drive.options).trajectory
            np.savez(path, stamps=trajectory.stamps_ns, poses=trajectory.poses)
        arrays = np.load(path)
        found.append(Trajectory(arrays["stamps"], arrays["poses"]))
    return found


def _errors(trajectory: Trajectory, truth: Relations | Trajectory) -> dict[str, float]:
    if isinstance(truth, Trajectory):
        absolute = absolute_errors(trajectory, truth)
        known, _ = associate(truth, trajectory, tolerance_ns=1000)  # of a thinned log the others are interpolated
        used = Trajectory(truth.stamps_ns[known], truth.poses[known])
        return {**_errors(trajectory, draw_relations(used)), "ate_m": absolute.trans_rmse_m}
    relations = clip_relations(truth, trajectory)
    assert relations is not None
    return {"relations_m": relation_errors(trajectory, relations).trans_mean_m}


def _scores(scans: Sequence[Beams], poses: FloatArray) -> dict[str, float]:
    """The score that ships, and others of the literature; less is better."""
    ends = [scan.ends for scan in scans]
    return {
        SHIPPED: score_drawn_scans(scans, poses).nats_per_beam,
        **{f"occupied cells of {100 * cell:g} cm": _count_occupied(ends, poses, cell) for cell in (0.025, 0.05, 0.1)},
        "mean map entropy": _mean_map_entropy(ends, poses),
        "leave one visit out": _leave_one_out(ends, poses, _visits(poses)),
    }


def _spoil(poses: FloatArray) -> dict[str, FloatArray]:
    """Trajectories that are wrong, each in a way that some score rewards."""
    half = len(poses) // 2
    first, second = poses[:half], poses[half:]
    rng = np.random.default_rng(0)
    return {
        "all poses in one place": np.zeros_like(poses),
        "turned, never moved": poses * [0, 0, 1],
        "a tenth too short": poses * [0.9, 0.9, 1],
        "second half laid over the first": np.concatenate([first, compose(poses[0], between(poses[half], second))]),
        "walls doubled by 0.3 m": np.concatenate([first, compose(np.array([0.3, 0, 0]), second)]),
        "mapped twice, 100 m apart": np.concatenate([first, compose(np.array([100.0, 0, 0]), second)]),
        "noise of 2 cm": poses + rng.normal(0, [0.02, 0.02, 0.003], poses.shape),
        "each scan elsewhere": poses + rng.uniform(-300, 300, poses.shape),
    }


def _count_occupied(scans: Sequence[FloatArray], poses: FloatArray, cell_m: float) -> float:
    """Cells in which beams end (Filatov et al. 2017), the mean over four places of the grid."""
    points = np.concatenate([transform_points(pose, scan) for pose, scan in zip(poses, scans, strict=True)])
    return float(np.mean([_cells(points + share * cell_m, cell_m).max() + 1 for share in (0.0, 0.25, 0.5, 0.75)]))


def _visits(poses: FloatArray) -> IntArray:
    """Number of the visit of each scan: the way is cut into pieces."""
    steps = np.diff(poses, axis=0)
    way = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) + np.abs(wrap(steps[:, 2])))
    return np.concatenate([[0], way // _VISIT_M]).astype(np.int64)


def _cells(points: FloatArray, cell_m: float) -> IntArray:
    columns, rows = (np.unique(one, return_inverse=True)[1] for one in np.floor(points / cell_m).T)
    return np.asarray(np.unique(columns * (int(rows.max()) + 1) + rows, return_inverse=True)[1])


def _mean_map_entropy(scans: Sequence[FloatArray], poses: FloatArray, radius_m: float = 0.3) -> float:
    """Mean of ln det(2 pi e covariance) / 2 of the ends about each of 2000 ends (Droeschel et al. 2014)."""
    from scipy.spatial import KDTree

    points = np.concatenate([transform_points(pose, scan) for pose, scan in zip(poses, scans, strict=True)])
    about = KDTree(points).query_ball_point(points[:: len(points) // 2000], radius_m)
    inside = (points[near] for near in about if len(near) >= 5)
    entropies = [0.5 * math.log(np.linalg.det(math.tau * math.e * np.cov(near.T)) + 1e-12) for near in inside]
    return float(np.mean(entropies))


def _leave_one_out(scans: Sequence[FloatArray], poses: FloatArray, visits: IntArray, cell_m: float = 0.1) -> float:
    """Mean of -ln p(what a visit saw of a cell | what the other visits saw of it), occupied or free, for each beam."""
    points, hits, which = [], [], []
    for scan, pose, visit in zip(scans, poses, visits.tolist(), strict=True):
        ends = transform_points(pose, scan[::2])
        lengths = np.hypot(*(ends - pose[:2]).T)
        free = np.maximum((lengths / cell_m).astype(int) - 1, 0)
        beam = np.repeat(np.arange(len(ends)), free)
        along = (np.arange(len(beam)) - np.repeat(np.cumsum(free) - free, free) + 0.5) * cell_m / lengths[beam]
        points += [pose[:2] + along[:, None] * (ends[beam] - pose[:2]), ends]
        hits += [np.zeros(len(beam), bool), np.ones(len(ends), bool)]
        which.append(np.full(len(beam) + len(ends), visit))
    hit = np.concatenate(hits)
    cells = _cells(np.concatenate(points), cell_m)
    seen, of = np.unique(cells * (int(visits.max()) + 1) + np.concatenate(which), return_inverse=True)
    occupied = np.bincount(of, hit) > 0
    cell = seen // (int(visits.max()) + 1)
    others = np.bincount(cell)[cell] - 1
    expected = (np.bincount(cell, occupied)[cell] - occupied + 0.1) / (others + 0.2)
    return float(-np.log(np.where(occupied, expected, 1 - expected)).sum() / hit.sum())


def _judge(drive: Drive, folder: Path) -> dict[str, Any]:
    trajectories = _map_all(drive, folder)
    scans = [scan for _, scan in open_log(drive.log, drive.options)]
    places = sample_evenly(range(len(scans)))
    beams = [scans[k].beams(0.05, 30.0) for k in places]
    errors = [_errors(trajectory, drive.truth) for trajectory in trajectories]
    scores = [_scores(beams, trajectory.poses[places]) for trajectory in trajectories]
    best = scores[0]
    ratios = {name: _scores(beams, poses) for name, poses in _spoil(trajectories[0].poses[places]).items()}
    return {
        "scans": len(scans),
        "spearman": {
            name: {
                error: [round(value, 3) for value in rank_correlation([one[name] for one in scores], of)]
                for error, of in ((error, [one[error] for one in errors]) for error in errors[0])
            }
            for name in best
        },
        "times_the_default": {
            name: {fault: round(found[name] / best[name], 3) for fault, found in ratios.items()}
            for name in best
            if name != "mean map entropy"  # a difference counts in a logarithm, no ratio
        },
        "less_entropy_than_the_default": [
            fault for fault, found in ratios.items() if found["mean map entropy"] < best["mean map entropy"]
        ],
        "errors": [{name: round(value, 5) for name, value in one.items()} for one in errors],
        "scores": [round(one[SHIPPED], 5) for one in scores],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge the scores and write what was found."""
    parser = argparse.ArgumentParser(description="Rank correlation of self-consistency scores with true errors.")
    parser.add_argument("data", type=Path, help="folder of the public logs")
    parser.add_argument("--folder", type=Path, required=True, help="for the trajectories, which are made once")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/self_consistency.json"))
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    drives = [*(_simulated_drive(seed, given.folder) for seed in _WORLDS), *_real_drives(given.data)]
    logs = {}
    for drive in drives:
        logs[drive.name] = _judge(drive, given.folder)
        print(drive.name, logs[drive.name]["spearman"], flush=True)
    write_document(
        given.out,
        "python benchmarks/self_consistency.py DATA --folder FOLDER; seed 0; [coefficient, 95 % interval]",
        configurations=draw_configurations(),
        logs=logs,
    )


if __name__ == "__main__":
    main()
