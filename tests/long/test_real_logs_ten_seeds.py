"""Ten seeds of each real log keep the bands."""

import numpy as np
import pytest

import gridslam
from far_apart import gmapping_path, off_from
from support.real_logs import ACES, CSAIL, INTEL, SPARSE, check_seed, errors_of

SEEDS = range(10)


@pytest.mark.parametrize("band", [INTEL, ACES, CSAIL], ids=lambda band: band.log)
def test_relations(data_dir, tmp_path, band, record_property):
    errors = [errors_of(data_dir, band, seed, tmp_path) for seed in SEEDS]
    record_property("mean of each seed, m", " ".join(f"{e.trans_mean_m:.4f}" for e in errors))
    record_property("mean, deg", f"{np.mean([e.rot_mean_deg for e in errors]):.3f}")
    record_property("worst relation, m", f"{max(e.trans_max_m for e in errors):.3f}")
    for of_seed in errors:
        check_seed(of_seed, band)


@pytest.mark.parametrize("name", SPARSE)
def test_logs_of_key_scans(data_dir, name, record_property):
    reference, log = gmapping_path(data_dir, name), data_dir / "sparse" / f"{name}.clf.gz"
    off = [off_from(gridslam.map_log(log, seed=seed).trajectory.poses, reference) for seed in SEEDS]
    record_property("ATE of each seed, m", " ".join(f"{e:.3f}" for e in off))
    assert max(off) < SPARSE[name]
