"""Covariances of simulated drives are of the errors' size, in buildings and in corridors."""

from __future__ import annotations

import numpy as np
import pytest

from covariances import judge
from gridslam.config import Configuration
from gridslam.slam.full_slam import surface_adjustment

pytestmark = pytest.mark.long

SEEDS = range(301, 306)
"""No parameter was chosen by them."""

LARGEST = 5.0
"""Of average NEES, where 3 is expected: five drives have few independent errors."""


def averages(kind: str, configuration: Configuration) -> dict[str, float]:
    drives = [judge(kind, seed, configuration) for seed in SEEDS]
    return {name: float(np.mean([d[name] for d in drives])) for name in ("online_nees", "final_nees", "final_inside")}


@pytest.mark.parametrize("kind", ["random", "rooms", "bare_corridors", "bare_corridors_10m", "halls", "sparse"])
def test_average_nees_lies_in_its_band(kind):
    found = averages(kind, Configuration())
    assert 1.0 < found["final_nees"] < LARGEST
    assert found["final_inside"] > 85
    assert 0.05 < found["online_nees"] < 6.0


def test_scans_that_count_fully_in_each_of_their_pairs_are_found_out(monkeypatch):
    """They have 9.1 in random buildings, beyond the band."""
    monkeypatch.setattr(surface_adjustment, "share_information", lambda pairs: np.ones(len(pairs)))
    assert averages("random", Configuration())["final_nees"] > 1.5 * LARGEST
