"""Maps of real logs keep their bands: two seeds of each log here, ten in tests/long."""

from __future__ import annotations

import numpy as np
import pytest

from support.real_logs import ACES, INTEL, check_csail, check_seed, csail_end_error, errors_of


@pytest.mark.parametrize("band", [INTEL, ACES], ids=lambda band: band.log)
def test_relations(data_dir, tmp_path, band):
    errors = [errors_of(data_dir, band, seed, tmp_path) for seed in (0, 1)]
    for of_seed in errors:
        check_seed(of_seed, band)
    # The mean of two seeds may lie above that of ten by what the seeds scatter.
    assert np.mean([e.trans_mean_m for e in errors]) <= (band.mean_m + band.seed_m) / 2
    assert np.mean([e.rot_mean_deg for e in errors]) <= band.mean_deg


@pytest.mark.parametrize("band", [INTEL, ACES], ids=lambda band: band.log)
def test_relations_of_the_filter_alone(data_dir, tmp_path, band):
    check_seed(errors_of(data_dir, band, 0, tmp_path, loop_closure=False), band)


def test_intel_without_its_odometry(data_dir, tmp_path):
    """Its long corridor has door frames, and nothing else that tells how far along it the robot is."""
    check_seed(errors_of(data_dir, INTEL, 0, tmp_path, odometry=False), INTEL)


def test_csail(data_dir):
    check_csail(*csail_end_error(data_dir, seed=0))
