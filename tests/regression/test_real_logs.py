"""Maps of real logs keep their bands: one seed of each log here, ten in tests/long."""

import pytest

from support.real_logs import ACES, CSAIL, INTEL, check_seed, errors_of


@pytest.mark.parametrize("band", [INTEL, ACES, CSAIL], ids=lambda band: band.log)
def test_relations(data_dir, tmp_path, band):
    check_seed(errors_of(data_dir, band, 0, tmp_path), band)


@pytest.mark.parametrize("band", [INTEL, ACES, CSAIL], ids=lambda band: band.log)
def test_relations_of_the_filter_alone(data_dir, tmp_path, band):
    errors = errors_of(data_dir, band, 0, tmp_path, loop_closure=False)
    assert errors.trans_mean_m <= band.filter_m


def test_intel_without_its_odometry(data_dir, tmp_path):
    """Its long corridor has door frames, and nothing else that tells how far along it the robot is."""
    assert errors_of(data_dir, INTEL, 0, tmp_path, odometry=False).trans_mean_m <= 0.0150
