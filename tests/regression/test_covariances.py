"""Covariances of simulated drives are of the errors' size, in buildings and in bare corridors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from covariances import judge
from gridslam.config import Configuration
from gridslam.slam.full_slam import surface_adjustment
from gridslam.slam.loop_closure import drift_model
from support.corridors import drive

pytestmark = pytest.mark.long

SEEDS = range(301, 306)
"""No parameter was chosen by them."""


def averages(kind: str, configuration: Configuration) -> dict[str, float]:
    drives = [judge(kind, seed, configuration) for seed in SEEDS]
    return {name: float(np.mean([d[name] for d in drives])) for name in ("online_nees", "final_nees", "final_inside")}


@pytest.mark.parametrize("kind", ["random", "rooms", "bare_corridors"])
def test_average_nees_lies_in_its_band(kind):
    """3 is expected; five drives have few independent errors: of twenty the averages are 1.6 to 2.9, online 0.7 to 2.5.

    Halls (0.5) and corridors seen 10 m far (6) are outside of this band.
    """
    found = averages(kind, Configuration())
    assert 1.0 < found["final_nees"] < 5.0
    assert found["final_inside"] > 85
    assert 0.2 < found["online_nees"] < 6.0


def test_increments_that_claim_too_little_are_found_out(monkeypatch):
    """A third of the drift, and matches four times as precise, each key scan's for itself."""
    usual = Configuration()
    monkeypatch.setattr(drift_model, "_POSITION_RATIO", 0.1)
    monkeypatch.setattr(surface_adjustment, "_INDEPENDENT_PAIRS", 64)
    drift = replace(usual.loop_closure.drift, sigma_rad_per_sqrt_m=0.0005, sigma_rad_per_sqrt_rad=1e-3)
    assert averages("random", replace(usual, loop_closure=replace(usual.loop_closure, drift=drift)))["final_nees"] > 10


@pytest.mark.parametrize(("length_m", "range_m"), [(10.0, 5.0), (40.0, 10.0), (40.0, 30.0)])
def test_along_bare_corridors_the_way_is_the_odometrys_and_reported(length_m, range_m):
    """Three drives each; the odometry is off by up to 1.4 % itself."""
    for seed in range(20, 23):
        found = drive(length_m, range_m, seed)
        assert found.online == pytest.approx(found.odometry, abs=0.03)
        assert found.full == pytest.approx(1.0, abs=0.03)
        assert found.flagged_blind > 0.9
        assert found.flagged_seen < 0.1
