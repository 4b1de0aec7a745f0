"""Landmarks that are in a map twice are found as sets of pairs, and others are left as they are."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.models.landmark import RangeBearing
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.landmarks.merging import MergeSearch
from support.landmark_world import MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
COUNT = 12
AROUND = 126  # steps, once around


@pytest.fixture(scope="module")
def doubled():
    """A drive once and a half around the ring, whose landmarks have other names from the second time on."""
    steps, _ = drive(ring(COUNT), AROUND * 3 // 2, np.random.default_rng(4), SENSOR)
    names = [step.observations.landmarks + COUNT * (k >= AROUND) for k, step in enumerate(steps)]
    renamed = [
        type(step)(step.stamp_ns, step.increment, None, type(step.observations)(step.observations.values, of_step))
        for step, of_step in zip(steps, names, strict=True)
    ]
    return LandmarkGraphSlam(SENSOR).solve(renamed, MOTION), names


def test_a_second_copy_of_a_place_becomes_the_first(doubled):
    """Most of the 12 copies are found at once, and each with the landmark that it is a copy of."""
    solution, names = doubled
    merged = MergeSearch()(solution, names)
    before = solution.landmarks.names
    assert (merged % COUNT == before % COUNT).all()
    assert (merged != before).sum() >= 4


def test_what_is_observed_together_is_never_one(doubled):
    """Not even where any distance is near enough."""
    solution, names = doubled
    merged = dict(
        zip(
            solution.landmarks.names.tolist(),
            MergeSearch(together=0.0, gate=1e9)(solution, names).tolist(),
            strict=True,
        )
    )
    for of_step in names:
        assert len({merged[name] for name in of_step.tolist()}) == len(of_step)
