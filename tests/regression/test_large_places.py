"""Large places are recognized: the robot comes back after hundreds of metres, and believes to be metres away."""

import gzip

import numpy as np
import pytest

import gridslam
from far_apart import off_from
from gridslam.evaluation import relation_errors
from gridslam.io.trajectories import read_relations


def test_the_corridors_of_a_hospital_are_not_doubled(data_dir, tmp_path):
    """1.4 km; Cartographer's published error is 0.108 m, that of commit 782021d8, with corridors doubled, 0.286 m."""
    relations = tmp_path / "hospital.relations"
    relations.write_bytes(gzip.decompress((data_dir / "large" / "hospital.relations.gz").read_bytes()))
    result = gridslam.map_log(data_dir / "large" / "hospital.clf.bz2", seed=0)
    errors = relation_errors(result.trajectory, read_relations(relations))
    assert errors.trans_mean_m < 0.15  # 0.12 to 0.13 by the tracker
    assert errors.trans_max_m < 2.5  # 6.2 where corridors are doubled


@pytest.mark.parametrize("seed", [0, 3])
def test_a_campus_is_closed(data_dir, seed):
    """1.75 km, a scan a metre; commit 782021d8 was off by 41.5 and 24.5 m with these seeds."""
    with gzip.open(data_dir / "large" / "freiburg-campus.ref.tum.gz", "rt") as file:
        rows = np.loadtxt(file)
    reference = np.column_stack([rows[:, 1:3], 2 * np.arctan2(rows[:, 6], rows[:, 7])])
    result = gridslam.map_log(data_dir / "large" / "freiburg-campus.clf.gz", seed=seed)
    assert off_from(result.trajectory.poses, reference) < 0.65  # 0.39 to 0.41; the reference has jumps of its own
    # 1.48 and 1.18 with these seeds; 17 where the heading that is lost in a sharp turn at 920 m is not searched for
    assert off_from(result.online_trajectory.poses, reference) < 2
