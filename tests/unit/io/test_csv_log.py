"""Scans in CSV: what is written is read, what people write is read, and what is wrong is told with line and column."""

from __future__ import annotations

import gzip
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import ArgumentError, InputError
from gridslam.io.csv import CsvLog, angles_of_rotation, rotation_of_angles, write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, LaserScan, Odometry, ScanGeometry

HIT, NO_RETURN, INVALID = BeamStatus.HIT, BeamStatus.NO_RETURN, BeamStatus.INVALID
HEADER = "stamp_s,angle_min_rad,angle_increment_rad,ranges_m\n"
ROW = "1.5,-1.5,1.5,1 2 3\n"

finite = st.floats(-1e4, 1e4)
angles = st.floats(-math.pi, math.pi)


@st.composite
def measurements(draw: st.DrawFn) -> Measurement:
    stamp = draw(st.integers(-(2**60), 2**60))
    beams = draw(st.integers(1, 30))
    mounting = np.eye(4)
    mounting[:3, :3] = rotation_of_angles(draw(angles), draw(st.floats(-math.pi / 2, math.pi / 2)), draw(angles))
    mounting[:3, 3] = [draw(st.floats(-100, 100)) for _ in range(3)]
    step = draw(st.floats(0.01, 0.2)) * draw(st.sampled_from([-1, 1]))
    geometry = ScanGeometry(draw(angles) + step * np.arange(beams), mounting)
    lengths = st.floats(-1, 40) | st.sampled_from([math.nan, math.inf, 0.0])
    ranges = draw(st.lists(lengths, min_size=beams, max_size=beams))
    least, most = draw(st.floats(0, 1)), draw(st.floats(2, 50) | st.just(math.inf))
    scan = LaserScan.from_ranges(
        stamp,
        ranges,
        geometry,
        range_min_m=least,
        range_max_m=most,
        sensor=draw(st.sampled_from(["front", "/a/scan", 'of "two", left', "Gerät"])),
        frame="laser",
        beam_times_s=draw(st.none() | st.just(np.arange(beams) * 1e-4)),
    )
    pose = [draw(finite), draw(finite), draw(st.floats(-3.1, 3.1))]
    odometry = draw(st.none() | st.just(Odometry.at(stamp + draw(st.sampled_from([0, 0, 7])), pose)))
    return Measurement(odometry, scan)


def same(a: Measurement, b: Measurement) -> None:
    """Bit for bit, but for directions: their angles are rebuilt from first and step."""
    assert (a.odometry is None) == (b.odometry is None)
    if a.odometry is not None and b.odometry is not None:
        assert a.odometry.stamp_ns == b.odometry.stamp_ns
        np.testing.assert_allclose(a.odometry.pose, b.odometry.pose, rtol=0, atol=1e-15 * 4)  # wrap
    for name in ("stamp_ns", "sensor", "frame", "range_min_m", "range_max_m"):
        assert getattr(a.scan, name) == getattr(b.scan, name)
    np.testing.assert_array_equal(a.scan.status, b.scan.status)
    hit = a.scan.status == HIT
    np.testing.assert_array_equal(a.scan.ranges[hit], b.scan.ranges[hit])
    np.testing.assert_allclose(a.scan.geometry.directions, b.scan.geometry.directions, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(a.scan.geometry.base_from_laser[:3, 3], b.scan.geometry.base_from_laser[:3, 3])
    assert (a.scan.beam_times_s is None) == (b.scan.beam_times_s is None)
    if a.scan.beam_times_s is not None and b.scan.beam_times_s is not None:
        np.testing.assert_allclose(a.scan.beam_times_s, b.scan.beam_times_s, rtol=0, atol=1e-15)


@settings(deadline=None, max_examples=60)
@given(st.lists(measurements(), min_size=1, max_size=4))
def test_what_is_written_is_read(tmp_path_factory, written):
    path = tmp_path_factory.mktemp("csv") / "log.csv.gz"
    write_csv_log(path, iter(written))
    read = list(CsvLog(path))
    assert len(read) == len(written)
    for before, after in zip(written, read, strict=True):
        same(before, after)


@given(angles, st.floats(-math.pi / 2, math.pi / 2), angles)
def test_a_rotation_comes_back_from_its_angles(roll, pitch, yaw):
    rotation = rotation_of_angles(roll, pitch, yaw)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation_of_angles(*angles_of_rotation(rotation)), rotation, rtol=0, atol=2e-9)


def read(tmp_path, text, **options):
    path = tmp_path / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    log = CsvLog(path, **options)
    return list(log), log.statistics


def test_columns_in_any_order_comments_quotes_and_line_ends_of_windows(tmp_path):
    text = (
        b"\xef\xbb\xbf# a drive\r\n"
        b'"ranges_m",odom_theta_rad,stamp_s,odom_y_m,odom_x_m,angle_increment_rad,angle_min_rad\r\n'
        b"\r\n"
        b'"1 2",4,1e3,-1,0.5,0.1,0\r\n# the end\r\n5,,1001,,,0,0\r\n'
    )
    measured, statistics = read(tmp_path, text)
    np.testing.assert_allclose(measured[0].odometry.pose, [0.5, -1, 4 - 2 * math.pi])
    assert [m.scan.stamp_ns for m in measured] == [1000 * 10**9, 1001 * 10**9]
    assert measured[1].odometry is None
    assert statistics.beam_counts == {2: 1, 1: 1}


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        (HEADER, None, "expected a row for each scan, got none"),
        ("stamp_s;ranges_m\n", 1, "expected names of columns with commas between them, got 'stamp_s;ranges_m'"),
        ("stamp_s,ranges\n", 1, "got 'ranges'"),
        ("stamp_s,ranges_m\n", 1, "got none named angle_min_rad"),
        (HEADER.replace("\n", ",stamp_s\n"), 1, "got one of them twice"),
        (HEADER + "1,0,0.1\n", 2, "expected 4 cells as in the first line, got 3"),
        (HEADER + ROW + "1;2,0,0.1,1\n", 3, "column stamp_s: expected a stamp in seconds"),
        (HEADER + ROW + ",0,0.1,1\n", 3, "column stamp_s: expected a stamp in seconds"),
        (HEADER + "1,x,0.1,1 2\n", 2, "column angle_min_rad: expected a number, got 'x'"),
        (HEADER + "1,nan,0.1,1 2\n", 2, "column angle_min_rad: expected a number, got 'nan'"),
        (HEADER + "1,0,,1 2\n", 2, "column angle_increment_rad: expected a number, got ''"),
        (HEADER + "1,0,0,1 2\n", 2, "angle_increment_rad: expected beams in different directions"),
        ("time_increment_s," + HEADER + "1e9," + ROW, 2, "column time_increment_s: expected a scan that takes less"),
        (HEADER + "1,-90,1,1 2\n", 2, "look like degrees"),
        (HEADER + "1,0,1,1 2 3 4 5 6 7 8 9\n", 2, "angle_increment 1 rad, more than one turn"),
        (HEADER + "1,0,0.1,1 2 - 4\n", 2, "column ranges_m: expected numbers with blanks between them, got '-' as 3."),
        (HEADER + "1,0,0.1,\n", 2, "column ranges_m: expected at least one range, got none"),
        (HEADER + '1,0,0.1,"1 2\n', 2, "expected cells with commas between them"),
        ("odom_x_m,odom_y_m,odom_theta_rad," + HEADER + "1,,0," + ROW, 2, "column odom_y_m: expected a number, got ''"),
        ("odom_x_m,odom_y_m,odom_theta_rad," + HEADER + "1,inf,0," + ROW, 2, "column odom_y_m: expected a number"),
        ("odom_x_m,odom_y_m,odom_theta_rad," + HEADER + "1,2e9,0," + ROW, 2, "odom_y_m: expected a number of at most"),
        ("laser_x_m," + HEADER + "-101," + ROW, 2, "column laser_x_m: expected a number of at most 100, got '-101'"),
        (
            "laser_yaw_rad," + HEADER + "90," + ROW,
            2,
            "column laser_yaw_rad: expected a number of at most 6.28319, got '90'",
        ),
        ("range_min_m," + HEADER + "-1," + ROW, 2, "column range_min_m: expected a number >= 0, got '-1'"),
        (("frame," + HEADER).encode() + b"\xff," + ROW.encode(), 2, "column frame: expected text in UTF-8"),
        (HEADER + ROW + "2.5,-1.5,1.5,1 2 3", None, "the last line has no line end: it is cut off; 1 scans were read"),
        (gzip.compress((HEADER + ROW).encode(), mtime=0)[:-4], None, "the compressed file is cut off"),
    ],
)
def test_what_is_wrong_is_told_with_line_and_column(tmp_path, text, line, problem):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert caught.value.line == line
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    "scan",
    [
        LaserScan.from_ranges(0, [1, 2, 3], ScanGeometry([0, 0.1, 0.3])),
        LaserScan.from_ranges(0, [1, 2, 3], ScanGeometry([0, 0.1, 0.2]), beam_times_s=[0, 0.1, 0.3]),
        LaserScan.from_ranges(0, [1, 2, 3], ScanGeometry([0, 0.1, 0.2]), beam_times_s=[1, 1.1, 1.2]),
        LaserScan(0, np.array([5.0]), np.array([HIT], np.uint8), ScanGeometry([0.0]), 0.0, 5.0),
        LaserScan.from_ranges(0, [1], ScanGeometry([0]), sensor="a\nb"),
        LaserScan.from_ranges(0, [], ScanGeometry([])),
    ],
)
def test_what_the_columns_cannot_say_is_refused(tmp_path, scan):
    with pytest.raises(ArgumentError):
        write_csv_log(tmp_path / "log.csv", [Measurement(None, scan)])
    assert not list(tmp_path.iterdir())
