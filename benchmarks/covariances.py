"""Do covariances mean something? Average NEES against simulated truth, online and final, in eight kinds of worlds.

    python benchmarks/covariances.py [KIND or LOG ...] [--seeds 20] [--first 101]
        [--set NAME=VALUE ...] [--out FILE]

Each drive is mapped with the defaults. NEES is taken of every pose after the first tenth of the drive, in the frame of
the first pose, which is given; its expectation is 3, and 95 of 100 should lie below 7.81. The parameters of the
covariances were set on the seeds 1 to 12. Of a real log the seeds are those of the filter, and its online poses are
compared with its final ones, which err much less.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aliasing_worlds import make_world
from gridslam import map_log
from gridslam.config import Configuration, override
from gridslam.evaluation import nees
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, simulate
from gridslam.types import FloatArray, StepReport
from measure import make_parser, write_document
from report import table
from simulated import map_drive, thin

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
"""World and the laser's range by kind."""

QUANTILE = 7.8147


def simulated(kind: str, seed: int) -> tuple[list[Measurement], np.ndarray]:
    """Measurements of a drive, and true poses (N, 3)."""
    world, range_m = WORLDS[kind]
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    lidar = LidarConfig(range_max_m=range_m)
    log = simulate(make_world(world, np.random.default_rng(seed)), RobotConfig(), OdometryNoise(), lidar, rng)
    measurements = list(log.measurements)
    truth = log.truth.poses
    if kind != "sparse":
        return measurements, truth
    kept = thin(truth, 1.0, 0.5)
    return [measurements[k] for k in kept], truth[kept]


def judge(kind: str, seed: int, configuration: Configuration | None = None) -> dict[str, Any]:
    """Map one drive; average NEES and percentage below the quantile, online and final."""
    measurements, truth = simulated(kind, seed)
    reports, full = map_drive(measurements, configuration or Configuration(), seed)
    true = between(truth[0], truth)
    found = {"kind": kind, "seed": seed} | measure_consistency("online", *stack_reports(reports), true)
    found |= measure_consistency("final", full.poses, full.covariances, true)
    return found | {"rmse_m": float(np.sqrt(np.square((full.poses - true)[:, :2]).sum(axis=1).mean()))}


def judge_log(path: str, seed: int, configuration: Configuration) -> dict[str, Any]:
    """Map a real log; average NEES and percentage below the quantile of its online poses, against its final ones."""
    reports: list[StepReport] = []
    observers = [lambda report, state, seconds: reports.append(report)]
    final = map_log(path, configuration=configuration, seed=seed, keep_particles=False, observers=observers)
    poses, covariances = stack_reports(reports)
    true = between(final.trajectory.poses[0], final.trajectory.poses)
    found = measure_consistency("online", between(poses[0], poses), covariances, true)
    return {"kind": Path(path).name, "seed": seed} | found


def stack_reports(reports: Sequence[StepReport]) -> tuple[FloatArray, FloatArray]:
    """Return the poses (N, 3) and covariances (N, 3, 3) of reports."""
    return np.array([report.pose for report in reports]), np.array([report.covariance for report in reports])


def measure_consistency(name: str, poses: FloatArray, covariances: FloatArray, true: FloatArray) -> dict[str, Any]:
    """Compute the average NEES and the percentage below the quantile, without the first tenth of the drive."""
    judged = slice(len(true) // 10, None)
    squares = nees(poses[judged], true[judged], covariances[judged])
    return {f"{name}_nees": float(squares.mean()), f"{name}_inside": float(100 * (squares < QUANTILE).mean())}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each kind, and write all drives."""
    parser = make_parser(__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(WORLDS)} [all of them], or a log")
    parser.add_argument("--seeds", type=int, default=20, help="drives of each kind [20]")
    parser.add_argument("--first", type=int, default=101, help="first seed [101]")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="of the simulated drives")
    given = parser.parse_args(arguments)
    configuration = override(Configuration(), *given.set)
    columns = "online_nees", "online_inside", "final_nees", "final_inside", "rmse_m"
    rows, drives = [], []
    for kind in given.kinds or WORLDS:
        seeds = range(given.first, given.first + given.seeds)
        of_kind = [(judge if kind in WORLDS else judge_log)(kind, seed, configuration) for seed in seeds]
        drives += of_kind
        means = [np.mean([drive.get(name, np.nan) for drive in of_kind]) for name in columns]
        rows.append([of_kind[0]["kind"], *("-" if np.isnan(mean) else f"{mean:.3g}" for mean in means)])
        print(*rows[-1], sep="  ", flush=True)
    print(text := table(["kind", *columns], rows))
    write_document(given.out, table=text.splitlines(), drives=drives)


if __name__ == "__main__":
    main()
