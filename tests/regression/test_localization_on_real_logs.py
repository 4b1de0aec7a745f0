"""Monte Carlo localization on real logs and maps: found from nothing, followed, missed and found again."""

import numpy as np
import pytest

from gridslam.api.localization import localize
from gridslam.evaluation.trajectory import absolute_errors
from gridslam.io.log import open_log
from gridslam.io.maps import read_map
from gridslam.localization import KnownMap
from gridslam.types import Trajectory
from support.meeting_rooms import MeetingRooms
from support.real_localization import Mapped, driven_way, follow, found_after_m, metres


@pytest.fixture(scope="module")
def intel(data_dir, tmp_path_factory):
    return Mapped.of(data_dir / "intel.clf.bz2", tmp_path_factory.mktemp("intel"))


@pytest.fixture(scope="module")
def meeting(data_dir):
    return MeetingRooms.of(data_dir)


def test_meeting_rooms_tracked(meeting):
    """Odometry's stamps are 0.1 s late: each pose is the true one of the scan before."""
    odometry = np.array([m.odometry.pose for m in meeting.measurements])
    np.testing.assert_allclose(odometry[1:], meeting.truth.poses[:-1], atol=1e-9)
    truth = Trajectory(meeting.truth.stamps_ns, meeting.into_map(meeting.truth.poses))
    result = localize(meeting.bag, meeting.yaml, pose=truth.poses[0])
    assert not result.lost.any()
    rmse = {True: 0.0, False: 0.0}
    for aligned in rmse:
        rmse[aligned] = absolute_errors(result.trajectory, truth, aligned=aligned, tolerance_ns=0).trans_rmse_m
    assert max(rmse.values()) < 0.07


@pytest.mark.parametrize("seed", [0, 1])
def test_meeting_rooms_from_nothing(meeting, seed):
    reports = follow(KnownMap(meeting.grid), meeting.measurements, seed)
    errors, driven = metres(reports, meeting.into_map(meeting.truth.poses)), driven_way(meeting.measurements)
    assert found_after_m(errors, driven, 0.3) < 10
    told = next(k for k, report in enumerate(reports) if not report.lost)
    assert driven[told] < 10
    assert errors[told:].max() < 0.3


@pytest.mark.parametrize("seed", [0, 1])
def test_turtlebot_on_its_floor(data_dir, seed):
    """Of its map four cells in five are unknown, and read as free where its thresholds are taken literally."""
    known = KnownMap(read_map(data_dir / "maps" / "mac_1st_floor_final.yaml"))
    reports = follow(known, list(open_log(data_dir / "bags" / "turtlebot4_floor")), seed)
    updates = [report for report in reports if report.skipped is None]
    assert all(known.is_free(report.poses).mean() > 0.99 for report in updates)
    found = next(k for k, report in enumerate(reports) if not report.lost)
    assert not any(report.lost for report in reports[found:])
    assert np.mean([report.inlier_ratio for report in updates]) > 0.7
    np.testing.assert_allclose(reports[-1].pose, [9.04, -13.92, -0.99], atol=0.15)  # where all seeds end


@pytest.mark.parametrize("seed", [0, 1])
def test_intel_from_nothing_in_the_middle(intel, seed):
    part = slice(len(intel.poses) // 2, len(intel.poses) // 2 + 1500)
    reports = follow(intel.known, intel.measurements[part], seed)
    errors, driven = metres(reports, intel.poses[part]), driven_way(intel.measurements[part])
    begin = found_after_m(errors, driven, 0.5)
    assert begin < 10
    after = errors[driven - driven[0] > 10]
    assert np.mean(after) < 0.05
    assert np.percentile(after, 99) < 0.15


@pytest.mark.parametrize("seed", [0, 1])
def test_intel_kidnapped(intel, seed):
    begin, other = 7000 + 200 * seed, 10_500 + 500 * seed
    measurements, poses = intel.kidnapped(slice(begin, begin + 400), slice(other, other + 900))
    assert np.hypot(*(poses[400] - poses[399])[:2]) > 3
    reports = follow(intel.known, measurements, seed, poses[0])
    errors, driven = metres(reports, poses), driven_way(measurements)
    assert errors[50:400].max() < 0.5
    assert found_after_m(errors[400:], driven[400:], 0.5) < 15
    assert any(report.lost for report in reports[400:])
    assert not reports[-1].lost
