"""What is recorded is read back as it was mapped, to the last bit."""

from __future__ import annotations

import errno
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import OutputError
from gridslam.geometry import rigid
from gridslam.io.bags.ros_messages import ScanMessage
from gridslam.io.csv import CsvLog
from gridslam.ros.node.accepted_scan import MeasurementBuilder, ScanRecorder, find_refusal_reason
from gridslam.types import Odometry

single = st.floats(width=32)
finite = st.floats(-100, 100)
names = st.text('abcXYZ/_," é', min_size=1, max_size=12).map(str.strip).filter(bool)


@st.composite
def accepted(draw):
    beams = draw(st.integers(2, 40))
    message = ScanMessage(
        stamp_ns=draw(st.integers(1, 2**62)),
        frame=draw(names),
        angle_min=draw(st.floats(-6, 6, width=32)),
        angle_increment=draw(st.floats(2**-10, 0.125, width=32)) * draw(st.sampled_from([-1, 1])),
        time_increment=draw(single),
        range_min=draw(single.filter(lambda metres: metres < np.inf)),
        range_max=draw(single),
        ranges=np.array(draw(st.lists(single, min_size=beams, max_size=beams)), np.float32),
    )
    assert find_refusal_reason(message, 2, 100) == ""
    quaternion = np.array(draw(st.tuples(finite, finite, finite, finite)))
    if np.linalg.norm(quaternion) < 1e-3:
        quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    quaternion /= np.linalg.norm(quaternion)
    place = draw(st.tuples(finite, finite, finite))
    matrix = rigid.to_matrix(rigid.from_quaternion(place, quaternion.tolist()))
    pose = draw(st.none() | st.tuples(finite, finite, st.floats(-math.pi, math.nextafter(math.pi, 0))))
    odometry = None if pose is None else Odometry.at(message.stamp_ns, pose)
    return MeasurementBuilder().build(message, draw(names), matrix, odometry, 0.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(accepted(), min_size=1, max_size=3))
def test_rows_are_read_back_bit_by_bit(tmp_path_factory, given_scans):
    path = tmp_path_factory.mktemp("record") / "scans.csv"
    recorder = ScanRecorder(path)
    for scan in given_scans:
        recorder.add(scan)
    recorder.close()
    read = list(CsvLog(path))
    assert len(read) == len(given_scans)
    for (
        (odometry, scan),
        (want_odometry, want),
    ) in zip(read, (one.measurement for one in given_scans), strict=True):
        assert (odometry is None) == (want_odometry is None)
        if odometry is not None:
            assert odometry.pose.tobytes() == want_odometry.pose.tobytes()
            assert odometry.stamp_ns == want_odometry.stamp_ns
        assert (scan.stamp_ns, scan.sensor, scan.frame) == (want.stamp_ns, want.sensor, want.frame)
        assert (scan.range_min_m, scan.range_max_m) == (want.range_min_m, want.range_max_m)
        assert scan.status.tobytes() == want.status.tobytes()
        np.testing.assert_array_equal(scan.ranges, want.ranges)
        assert scan.geometry.bearings.tobytes() == want.geometry.bearings.tobytes()
        np.testing.assert_array_equal(scan.geometry.base_from_laser, want.geometry.base_from_laser)
        assert (scan.beam_times_s is None) == (want.beam_times_s is None)
        if scan.beam_times_s is not None:
            assert scan.beam_times_s.tobytes() == want.beam_times_s.tobytes()


def plain(stamp_ns: int):
    message = ScanMessage(stamp_ns, "laser", 0.0, 0.1, 0.0, 0.02, 8.0, np.linspace(1, 7, 20, dtype=np.float32))
    return MeasurementBuilder().build(message, "scan", np.eye(4), Odometry.at(stamp_ns, (1.0, 2.0, 0.5)), 0.0)


def test_a_row_is_in_the_file_as_soon_as_it_is_written(tmp_path):
    """So a node that is killed has lost no scan that its filter was given."""
    recorder = ScanRecorder(tmp_path / "scans.csv")
    for k in range(1, 4):
        recorder.add(plain(k))
        assert len(list(CsvLog(tmp_path / "scans.csv"))) == k
    recorder.close()


def test_where_the_disk_is_full_the_record_ends_with_a_whole_row(tmp_path):
    """What comes later is not written even where there is room again: a replay would jump over what lacks."""

    class Nearly:
        """A file on a disk that is full after some bytes."""

        def __init__(self, file, left):
            self.file, self.left = file, left

        def write(self, data):
            if not self.left:
                raise OSError(errno.ENOSPC, "No space left on device")
            written = self.file.write(data[: self.left])
            self.left -= written
            return written

        def __getattr__(self, name):
            return getattr(self.file, name)

    recorder = ScanRecorder(tmp_path / "scans.csv")
    recorder.add(plain(1))
    recorder._file = full = Nearly(recorder._file, 50)
    assert recorder.is_whole
    with pytest.raises(OutputError, match="No space left on device; the record ends"):
        recorder.add(plain(2))
    assert not recorder.is_whole
    full.left = 10_000
    recorder.add(plain(3))
    recorder.close()
    assert [scan.stamp_ns for _, scan in CsvLog(tmp_path / "scans.csv")] == [1]
