"""Maps of real logs keep their bands: one seed of each log here, ten in tests/long."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

import gridslam
from far_apart import every_half_metre, gmapping_path, off_from
from gridslam.api.mapping import map_log
from gridslam.errors import InputError
from gridslam.evaluation import measure_self_consistency, relation_errors
from gridslam.evaluation.trajectory import absolute_errors
from gridslam.geometry.se2 import between
from gridslam.io.bags.bag import BagLog
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.log import LogOptions, open_log
from gridslam.io.trajectories import read_relations
from gridslam.slam.full_slam.merging import merge_pieces
from gridslam.types import Trajectory
from support.real_logs import ACES, CSAIL, INTEL, SPARSE, Backwards, check_seed, errors_of, poses_of


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


THINNED = {("aces", 10): 0.10, ("mit-csail", 5): 0.08, ("mit-csail", 10): 0.20}
"""Logs of which one in so many scans is taken, and how far off (m, rms); ecac047: 18.2, 15, 14.7 m."""


def map_both(log: Path, **options) -> tuple[gridslam.Trajectory, gridslam.Trajectory]:
    """The answer, and that of the filter alone."""
    filter_alone = gridslam.Configuration(loop_closure=None)
    full = gridslam.map_log(log, **options)
    alone = gridslam.map_log(log, configuration=filter_alone, **options)
    return full.trajectory, alone.trajectory


def both(log: Path, reference: np.ndarray) -> tuple[float, float]:
    """How far off (m, rms) the answer is, and that of the filter alone."""
    full, alone = map_both(log)
    return off_from(full.poses, reference), off_from(alone.poses, reference)


@pytest.mark.parametrize("name", SPARSE)
def test_logs_of_key_scans(data_dir, name):
    """The filter alone is off by 0.198, 0.108, 0.063 and 0.052 m."""
    answer = gridslam.map_log(data_dir / "sparse" / f"{name}.clf.gz").trajectory
    assert off_from(answer.poses, gmapping_path(data_dir, name)) < SPARSE[name]


@pytest.mark.parametrize(("name", "seed", "most_m"), [("acapulco", 1, 0.22), ("belgioioso", 0, 0.11)])
def test_logs_of_key_scans_by_every_second_one(data_dir, name, seed, most_m):
    """Two metres apart: seeds 0 to 2 of acapulco are off by 0.24, 0.19 and 0.19 m.

    They were by 0.23, 0.52 and 0.55 m where the odometry did not count as known then.
    """
    log = data_dir / "sparse" / f"{name}.clf.gz"
    answer = gridslam.map_log(log, options=LogOptions(every=2), seed=seed).trajectory
    assert off_from(answer.poses, gmapping_path(data_dir, name)[::2]) < most_m


@pytest.mark.parametrize(("name", "every"), THINNED)
def test_logs_thinned_by_number(data_dir, name, every):
    reference = poses_of(data_dir, name)[::every]
    answers = map_both(data_dir / f"{name}.clf.bz2", options=gridslam.LogOptions(every=every))
    full, alone = (off_from(answer.poses, reference) for answer in answers)
    assert full < THINNED[name, every]
    truth = data_dir / f"{name}.relations"
    if truth.exists():  # it decides between two answers that are closer to each other than two references are
        full, alone = (relation_errors(answer, read_relations(truth)).trans_mean_m for answer in answers)
    assert full < max(1.05 * alone, 0.05)


@pytest.mark.parametrize(("name", "most_m"), [("aces", 0.10), ("mit-csail", 0.06)])
def test_logs_thinned_by_way(data_dir, tmp_path, name, most_m):
    kept = every_half_metre(data_dir / f"{name}.clf.bz2")
    write_carmen(tmp_path / "thin.clf", kept.values())
    full, alone = both(tmp_path / "thin.clf", poses_of(data_dir, name)[list(kept)])
    assert full < most_m
    assert full < max(1.05 * alone, 0.05)


def test_a_corridor_seen_again_at_the_end_has_single_walls(data_dir):
    """DP-SLAM's own example, whose laser reports 8.18 m for beams that hit nothing; it has no truth.

    Surfaces of visits that are apart lie within 0.021 m; 0.044 to 0.29 m where the end is moved by 0.3 m.
    """
    log = data_dir / "loops" / "dpslam_loop5.clf.gz"
    scans = [scan for _, scan in open_log(log)]
    assert measure_self_consistency(gridslam.map_log(log).trajectory, scans).sharpness_m < 0.03


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


@pytest.fixture(scope="session")
def bags(data_dir):
    return data_dir / "bags"


def read(path, **options):
    log = BagLog(path, LogOptions(**options))
    return list(log), log


def test_p3dx_trace0(bags):
    measurements, log = read(bags / "p3dx_trace0.bag")
    assert len(measurements) == 958
    assert {len(scan) for _, scan in measurements} == {726}
    assert log.statistics.odometry_source == "/odom"
    assert log.statistics.odometry_length_m == pytest.approx(31.7, abs=0.05)
    assert log.statistics.without_odometry == 1  # the last: no odometry comes after it
    np.testing.assert_allclose(log.statistics.mountings["/base_scan"].pose, [0.135, 0, 0])
    assert not log.statistics.moving_mountings


def test_p3dx_sim_truth_is_mapped_near_the_truth(bags):
    """0.10 m to 0.13 m by seed. Ranges jump by 4 cm, for the simulated walls are pixels, and the laser sees 5.6 m far.

    Where ranges scatter, maps of walls lie behind them, and the way ahead comes out 2 % long.
    """
    true, _ = read(bags / "p3dx_sim_truth.bag", odometry_topic="/base_pose_ground_truth")
    truth = Trajectory(np.array([s.stamp_ns for _, s in true]), np.array([o.pose for o, _ in true]))
    found = map_log(bags / "p3dx_sim_truth.bag").trajectory
    assert absolute_errors(found, truth).trans_rmse_m < 0.16


def test_turtlebot4_floor(bags):
    measurements, log = read(bags / "turtlebot4_floor")
    assert len(measurements) == 357
    assert log.statistics.odometry_length_m == pytest.approx(8.3, abs=0.1)
    assert log.statistics.mountings["/scan"].pose[2] == pytest.approx(np.pi / 2)
    assert log.statistics.without_odometry == 3  # two before the first odometry, the last
    assert all(scan.beam_times_s is not None for _, scan in measurements)
    assert log.statistics.no_return_beams > 0


def test_handheld_broken_index(bags):
    measurements, log = read(bags / "handheld_broken_index.bag")
    assert len(measurements) == 360
    assert {len(scan) for _, scan in measurements} == {681}
    assert log.statistics.odometry_source == ""
    assert log.statistics.without_odometry == 360
    assert not log.statistics.truncated  # of the index alone something is wrong


@pytest.mark.parametrize("name", ["p3dx_trace0.bag", "turtlebot4_floor/macfirst_floor_take_2_0.db3"])
def test_real_bags_cut_off(bags, name, tmp_path):
    data = (bags / name).read_bytes()
    path = tmp_path / Path(name).name
    for share in (0.05, 0.3, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        outcome(path, keep_truncated=False)
        outcome(path, keep_truncated=True)


def outcome(path, **options):
    """Number of scans, or -1 where the bag is refused; anything else fails the test."""
    try:
        return sum(1 for _ in BagLog(path, LogOptions(**options)))
    except InputError as error:
        said = str(error)
    assert str(path) in said
    assert said.isprintable()  # one line
    return -1


@pytest.mark.parametrize(
    ("band", "seed", "most_m"),
    [(INTEL, 0, 0.0140), (ACES, 1, 0.046), (CSAIL, 0, 0.031)],
    ids=["intel", "aces", "csail"],
)
def test_logs_driven_backwards(data_dir, band, seed, most_m):
    """Six seeds of ACES have 0.035 to 0.042 m; seed 1 has 0.052 where key scans are not adjusted until they settle.

    With all beams counting alike Intel had 0.10, ACES 0.22 and CSAIL 0.029 m.
    """
    log = Backwards(open_log(data_dir / band.log))
    result = gridslam.map_log(log, seed=seed)
    assert len(result.trajectory) == band.scans
    errors = relation_errors(log.turn(result.trajectory), read_relations(data_dir / band.relations))
    assert errors.trans_mean_m <= most_m


def test_drives_among_people_are_merged_in_either_order(data_dir):
    """The scans of the first contradict the map of the second, but not the other way round."""
    logs = [data_dir / "loops" / f"wean{number}.clf.gz" for number in (1, 2)]
    pieces = [gridslam.map_log(log).map_piece.piece for log in logs]
    configuration = gridslam.Configuration()
    parts = configuration.mapper, configuration.loop_closure
    (there,), (back,) = merge_pieces(pieces, *parts), merge_pieces(pieces[::-1], *parts)
    first, second = len(pieces[0]), len(pieces[1])
    seen = between(there.piece.poses[0], there.piece.poses[first])
    again = between(back.piece.poses[second], back.piece.poses[0])
    assert np.abs(seen - again).max() < 0.1
