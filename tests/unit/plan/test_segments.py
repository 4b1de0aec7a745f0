"""Segments near others are found as by comparing all, and surface points do not depend on what is taken at a time."""

import numpy as np
import pytest

from gridslam.plan import surfaces
from gridslam.plan.segments import Segments


@pytest.mark.parametrize("count", [0, 1, 300])
def test_those_near_are_those_whose_boxes_meet(count):
    rng = np.random.default_rng(count)
    starts = rng.uniform(-20, 20, (count, 1, 2))
    segments = Segments.of(np.concatenate([starts, starts + rng.normal(0, 2, (count, 1, 2))], axis=1))
    for reach in (0.0, 0.5, 3.0):
        points = rng.uniform(-20, 20, 2) + rng.uniform(-1, 1, (3, 2))
        low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
        meets = (segments.ends.min(axis=1) <= high).all(axis=1) & (segments.ends.max(axis=1) >= low).all(axis=1)
        numbers, near = segments.near(points, reach)
        assert numbers.tolist() == np.flatnonzero(meets).tolist()
        assert near.ends.tolist() == segments.ends[meets].tolist()


def test_surface_points_do_not_depend_on_how_many_are_taken_at_a_time(monkeypatch):
    rng = np.random.default_rng(4)
    scans = [(rng.uniform(2, 8, 2), rng.uniform(0, 10, (50, 2)).round(1) * [1, 0.1]) for _ in range(40)]
    whole = surfaces.points_of_scans(iter(scans), 0.05)
    monkeypatch.setattr(surfaces, "_MOST_PENDING", 120)
    monkeypatch.setattr(surfaces, "_MOST_PAIRS", 70)
    parts = surfaces.points_of_scans(iter(scans), 0.05)
    assert len(parts) == len(whole) > 300
    assert parts.weights.sum() == 40 * 50
    assert parts.positions == pytest.approx(whole.positions)
    assert (parts.normals * whole.normals).sum(axis=1) == pytest.approx(np.ones(len(whole)))
    assert len(set(surfaces.label_surfaces(parts))) == len(set(surfaces.label_surfaces(whole))) > 1
