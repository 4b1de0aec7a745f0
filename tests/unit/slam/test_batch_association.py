"""Correspondences of a whole log are found, and of copies of a landmark one is dropped."""

from dataclasses import replace

import numpy as np

from gridslam.models.association import MaximumLikelihood
from gridslam.models.landmark import RangeBearing
from gridslam.models.systematic_errors import NO_ERRORS
from gridslam.slam.landmarks.batch_association import BatchAssociation
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.report import LandmarkMap
from support.landmark_world import MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)


def _associate(steps, **parameters):
    slam = FastSlam2(LandmarkFilters(SENSOR, MaximumLikelihood()))
    associate = BatchAssociation(slam, SENSOR, NO_ERRORS, particles=20, **parameters)
    return associate([replace(step) for step in steps], MOTION, np.random.default_rng(0))


def test_each_landmark_of_a_ring_is_found_once():
    steps, _ = drive(ring(12), 150, np.random.default_rng(1), SENSOR)
    found = _associate(steps)
    pairs = {
        (name, true)
        for ours, theirs in zip(found, steps, strict=True)
        for value, name in zip(ours.observations.values.tolist(), ours.observations.landmarks.tolist(), strict=True)
        for other, true in zip(theirs.observations.values.tolist(), theirs.observations.landmarks.tolist(), strict=True)
        if value == other
    }
    assert len(pairs) == len({name for name, _ in pairs}) == len({true for _, true in pairs}) == 12


def test_of_two_landmarks_at_one_place_that_are_never_seen_together_the_rarer_is_dropped():
    """The copies (0, 2) and (1, 3) are 0.1 m apart, as those that are seen together (0, 1) are."""
    positions = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1], [9.0, 9.0]])
    found = LandmarkMap(np.arange(5), positions, np.tile(1e-3 * np.eye(2), (5, 1, 1)), np.ones(5, np.int64))
    seen = [[0, 1]] * 20 + [[2, 3]] * 10 + [[4]] * 5
    associate = BatchAssociation(FastSlam2(LandmarkFilters(SENSOR, MaximumLikelihood())), SENSOR, NO_ERRORS)
    assert associate._drop_copies([np.array(names) for names in seen], found).names.tolist() == [0, 1, 4]
    assert associate._drop_copies([np.arange(5)] * 35, found).names.tolist() == [0, 1, 2, 3, 4]
