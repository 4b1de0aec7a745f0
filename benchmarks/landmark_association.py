"""Landmark methods on MRCLAM: errors with known and unknown correspondences, surplus landmarks, and consistency."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gridslam.api.landmarks import LandmarkMethod, LandmarkResult, map_landmarks
from gridslam.evaluation.consistency import nees
from gridslam.evaluation.maps import pair_by_name, pair_by_position
from gridslam.geometry.se2 import compose, inverse, transform_points
from measure import write_document

__all__ = ["median_nees", "row"]

_METHODS: tuple[LandmarkMethod, ...] = "ekf", "fastslam1", "fastslam2", "graph"


def median_nees(result: LandmarkResult) -> tuple[float, float]:
    """Median NEES of the poses (3 degrees of freedom: 2.37) and of the landmarks (2: 1.39).

    Both are in the frame of the first pose that the truth knows: covariances are given that pose. After an alignment of
    the whole path, what the heading at the begin contributes to the error would be gone, and not from the covariance.
    """
    compared = result.compare()
    known = result.log.truth
    assert compared is not None
    assert known is not None
    found, truth = compared
    true_from_map = compose(truth.poses[0], inverse(found.poses[0]))
    turn = np.eye(3)
    c, s = np.cos(true_from_map[2]), np.sin(true_from_map[2])
    turn[:2, :2] = [[c, -s], [s, c]]
    rows = np.searchsorted(result.stamps_ns, found.stamps_ns)
    covariances = turn @ result.covariances[rows] @ turn.T
    of_poses = nees(compose(true_from_map, found.poses), truth.poses, covariances + 1e-9 * np.eye(3))
    landmarks = result.landmarks
    if result.unknown:
        ours, theirs = pair_by_position(landmarks.positions, known.positions, true_from_map)
    else:
        ours, theirs = pair_by_name(landmarks.names, known.landmarks)
    apart = transform_points(true_from_map, landmarks.positions[ours]) - known.positions[theirs]
    spread = turn[:2, :2] @ landmarks.covariances[ours] @ turn[:2, :2].T
    of_landmarks = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(spread), apart)
    return float(np.median(of_poses)), float(np.median(of_landmarks)) if len(ours) else np.nan


def row(log: Path, method: LandmarkMethod, unknown: bool, seed: int) -> dict[str, Any]:
    """Figures of one run."""
    result = map_landmarks(log, method, unknown=unknown, seed=seed)
    poses, landmarks = result.errors()
    of_poses, of_landmarks = median_nees(result)
    return {
        "log": log.name,
        "method": method,
        "unknown": unknown,
        "seed": seed,
        "position_rmse_m": None if poses is None else round(poses.trans_rmse_m, 3),
        "landmark_rmse_m": None if landmarks is None else round(landmarks.rmse_m, 3),
        "found": 0 if landmarks is None else landmarks.found,
        "surplus": len(result.landmarks) if landmarks is None else landmarks.surplus,
        "nees_poses": round(of_poses, 2),
        "nees_landmarks": round(of_landmarks, 2),
    }


if __name__ == "__main__":  # python landmark_association.py DATA results/landmarks_mrclam.json SEEDS
    folder, out, seeds = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    rows = list[dict[str, Any]]()
    for seed in range(seeds):
        for unknown in (False, True):
            for method in _METHODS[: 3 if unknown else 4]:
                for robot in (1, 3):
                    rows.append(row(folder / f"mrclam6_Robot{robot}_Odometry.dat.gz", method, unknown, seed))
                    how = f"MRCLAM 6, seeds 0 to {seeds - 1}; RMSE in m, medians of NEES"
                    write_document(out, how, rows=rows)
