"""Surface points do not depend on how many end points are taken at a time."""

import numpy as np
import pytest

from gridslam.plan import surfaces


def test_surface_points_do_not_depend_on_how_many_are_taken_at_a_time(monkeypatch):
    rng = np.random.default_rng(4)
    scans = [(rng.uniform(2, 8, 2), rng.uniform(0, 10, (50, 2)).round(1) * [1, 0.1]) for _ in range(40)]
    whole = surfaces.points_of_scans(iter(scans), 0.05)
    monkeypatch.setattr(surfaces, "_MOST_PENDING", 120)
    parts = surfaces.points_of_scans(iter(scans), 0.05)
    assert len(parts) == len(whole) > 300
    assert parts.weights.sum() == 40 * 50
    assert parts.positions == pytest.approx(whole.positions)
    assert (parts.normals * whole.normals).sum(axis=1) == pytest.approx(np.ones(len(whole)))
    assert len(set(surfaces.label_surfaces(parts))) == len(set(surfaces.label_surfaces(whole))) > 1
