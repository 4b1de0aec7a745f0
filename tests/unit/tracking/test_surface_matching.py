"""Matching to the surfaces of the newest scans: exacter than cells, and only where surfaces say so."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.grid.scan_batch import ScanBatch
from gridslam.matching.surfaces import Surfaces
from gridslam.tracking.prediction import PoseEstimate, Prediction
from gridslam.tracking.recent_scans import RecentScans
from gridslam.tracking.surface_matching import match_to_surfaces
from gridslam.types import StoredScan

BEARINGS = np.linspace(-3.1, 3.1, 240)


def scan_from(pose, seed, half=(4.0, 3.0)):
    """Beams in a room about the origin, noise 1 cm; half its size (2,)."""
    ways = np.column_stack([np.cos(BEARINGS + pose[2]), np.sin(BEARINGS + pose[2])])
    corner = np.array(half)
    reach = np.where(ways > 0, (corner - pose[:2]) / ways, (-corner - pose[:2]) / ways).min(axis=1)
    reach += 0.01 * np.random.default_rng(seed).normal(size=len(reach))
    reach = np.minimum(reach, 12.0)
    return StoredScan(reach[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]), np.zeros(2))


def fit(scan):
    return Surfaces.of(ScanBatch.of([scan]))


def at(pose):
    """Found at a pose."""
    predicted = Prediction(pose, True, 0.1, 0.1, 0.0, 0.02, 0.01, 0.03)
    return PoseEstimate(pose, predicted, matched=True, lost=False, inlier_ratio=1.0)


def remember(poses, half=(4.0, 3.0), most=8):
    recent = RecentScans()
    for seed, pose in enumerate(poses):
        scan = scan_from(np.array(pose), seed, half)
        recent = recent.insert(scan, fit(scan), pose, most)
    return recent


POSES = [(0.2 * k, 0.05 * k, 0.06 * k) for k in range(10)]
TRUE = (2.0, 0.5, 0.6)


def test_a_match_is_exact_to_millimetres_and_hundredths_of_a_degree():
    recent = remember(POSES)
    own = fit(scan_from(np.array(TRUE), 99))
    errors = []
    for seed in range(20):
        off = np.random.default_rng(seed).normal(0, [0.02, 0.02, 0.01])
        found = match_to_surfaces(recent, own, at(tuple((np.array(TRUE) + off).tolist())))
        errors.append(between(np.array(TRUE), np.array(found)))
    rms = np.sqrt(np.square(errors).mean(axis=0))
    assert (rms < [0.004, 0.004, 0.0015]).all()  # of guesses that are off by 0.02, 0.02, 0.01


def test_what_has_few_points_or_would_move_far_stays():
    recent = remember(POSES)
    own = fit(scan_from(np.array(TRUE), 99))
    guess = (2.02, 0.48, 0.6)
    assert match_to_surfaces(recent, own, at(guess)) != guess
    assert match_to_surfaces(RecentScans(), own, at(guess)) == guess
    few = own._replace(points=own.points[::20], normals=own.normals[::20])
    assert match_to_surfaces(RecentScans(recent.scans[-1:]), few, at(guess)) == guess
    far = (2.12, 0.5, 0.6)
    assert match_to_surfaces(recent, own, at(far)) == pytest.approx(far, abs=1e-3)
    assert match_to_surfaces(recent, fit(StoredScan(np.empty((0, 2)), np.zeros(2))), at(guess)) == guess
