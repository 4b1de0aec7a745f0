"""Whether a trajectory or the relations that score it are nearer the truth: python benchmarks/relation_noise.py DATA.

A relation is the pose of one scan seen from another. Drawn together by it, and by the trajectory of `map_log`, both
scans show the same walls: the better of the two has the larger share of ends of one near ends of the other. The
odometry is scored in the same way: relations that lose against it, too, are coarse.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gridslam import map_log, open_log
from gridslam.evaluation import Relations
from gridslam.geometry.se2 import between, transform_points
from gridslam.io.trajectories import read_relations
from gridslam.types import FloatArray, IntArray
from measure import RESULTS, write_document
from report import table

LOGS = ("intel", "aces", "mit-csail", "large/hospital")
OFF_M = 0.1
"""Relations that a trajectory misses by more than this are counted."""

_WALL_M = 0.1
"""Standard deviation of the Gaussian by which the distance of an end to the nearest end of the other scan counts."""

_MARGIN = 0.01
"""Difference of the shares below which neither is better."""


def overlap(first: FloatArray, second: FloatArray, pose: FloatArray) -> float:
    """Share of the ends (M, 2) of a scan at `pose` (3,) of the first one's frame that lie on the ends (N, 2) there."""
    distances, _ = cKDTree(first).query(transform_points(pose, second))
    return float(np.exp(-0.5 * np.square(distances / _WALL_M)).mean())


def compare(relations: Relations, ends: Sequence[FloatArray], rows: IntArray, poses: FloatArray) -> dict[str, float]:
    """Count the relations (R) that poses (N, 3) miss by more than `OFF_M`, and which side is better there.

    `ends` are those of the N scans, `rows` (R, 2) the scans of each relation.
    """
    moved = between(poses[rows[:, 0]], poses[rows[:, 1]])
    off_m = np.hypot(*between(relations.poses, moved)[:, :2].T)
    compared = [k for k in np.flatnonzero(off_m > OFF_M) if min(len(ends[row]) for row in rows[k]) > 0]
    gains = np.array(
        [
            overlap(ends[a], ends[b], moved[k]) - overlap(ends[a], ends[b], relations.poses[k])
            for k, (a, b) in ((k, rows[k]) for k in compared)
        ]
    )
    return {
        "mean_error_m": float(off_m.mean()),
        "off": len(compared),
        "trajectory_better": int((gains > _MARGIN).sum()),
        "relation_better": int((gains < -_MARGIN).sum()),
    }


def nearest(stamps: IntArray, asked: IntArray) -> IntArray:
    """Indices of the stamps (N,) nearest to those asked for."""
    after = np.searchsorted(stamps, asked).clip(1, len(stamps) - 1)
    indices: IntArray = after - (asked - stamps[after - 1] < stamps[after] - asked)
    return indices


def main(arguments: Sequence[str] | None = None) -> int:
    """Print and write the comparison for each log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=RESULTS / "relation_noise.json")
    given = parser.parse_args(arguments)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in LOGS:
        log = given.data / f"{name}.clf.bz2"
        reference = log.with_name(log.name.replace(".clf.bz2", ".relations"))
        relations = read_relations(reference if reference.exists() else reference.with_suffix(".relations.gz"))
        measurements = sorted(open_log(log), key=lambda measured: measured.scan.stamp_ns)
        ends = [measured.scan.beams(0.05, 30.0).ends for measured in measurements]
        stamps = np.array([measured.scan.stamp_ns for measured in measurements])
        rows = np.column_stack([nearest(stamps, asked) for asked in (relations.from_ns, relations.to_ns)])
        odometry = np.array([measured.odometry.pose for measured in measurements if measured.odometry is not None])
        final = map_log(log, seed=0).trajectory
        assert np.array_equal(np.sort(final.stamps_ns), stamps)
        found[name] = {
            "gridslam": compare(relations, ends, rows, final.poses[np.argsort(final.stamps_ns)]),
            "odometry": compare(relations, ends, rows, odometry),
        }
        print(table(["", *found[name]["gridslam"]], [[kind, *counts.values()] for kind, counts in found[name].items()]))
    write_document(given.out, "python benchmarks/relation_noise.py DATA", off_m=OFF_M, logs=found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
