"""Scans in tables of other programs: `rostopic echo -p`, and rows of an angle and a distance."""

from functools import partial

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.log import LogFormat, detect_log_format, open_log
from gridslam.types import BeamStatus
from support.broken_logs import drive_about, echo_rows, point_rows, rostopic_rows

SCANS = drive_about(4)


def read(folder, text, name="log.csv"):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    log = open_log(folder / name)
    return list(log), log.statistics


@pytest.mark.parametrize("rows", [rostopic_rows, point_rows, echo_rows, partial(echo_rows, with_intensities=True)])
def test_a_drive_is_read_back_without_odometry(tmp_path, rows):
    back, statistics = read(tmp_path, rows(SCANS))
    assert detect_log_format(tmp_path / "log.csv") is LogFormat.CSV
    assert statistics.scan_count == statistics.without_odometry == len(back) == len(SCANS)
    unstated = {"the direction is not stated: angles are taken as counter-clockwise"}
    assert set(statistics.remarks) == (unstated if rows is point_rows else set())
    for (odometry, scan), (_, true) in zip(back, SCANS, strict=True):
        assert odometry is None
        assert abs(scan.stamp_ns - true.stamp_ns) < 1_000_000
        np.testing.assert_allclose(scan.geometry.bearings, true.geometry.bearings, atol=1e-6)
        hit = true.status == BeamStatus.HIT
        np.testing.assert_allclose(scan.ranges[hit], true.ranges[hit], rtol=1e-5, atol=1e-6)


RPLIDAR = "#RPLIDAR SCAN DATA\n#COUNT=4\n#Angle\tDistance\tQuality\n"


def test_units_that_are_not_stated_are_said(tmp_path):
    """The angles of an RPLIDAR count clockwise: else the map would be a mirror image."""
    rows = "".join(f"{angle}.0\t{distance}\t47\n" for angle, distance in ((0, 1500), (90, 0), (180, 2000), (359, 99)))
    (first, second), statistics = read(tmp_path, RPLIDAR + 2 * rows)
    np.testing.assert_allclose(np.degrees(first.scan.geometry.bearings), [0, -90, -180, -359])
    np.testing.assert_allclose(first.scan.ranges, [1.5, 0, 2, 0.099])
    assert first.scan.status.tolist() == [BeamStatus.HIT, BeamStatus.INVALID, BeamStatus.HIT, BeamStatus.HIT]
    assert (first.scan.stamp_ns, second.scan.stamp_ns) == (0, 100_000_000)
    assert first.scan.geometry is second.scan.geometry
    assert sorted(statistics.remarks) == [
        "the direction is not stated: angles are taken as clockwise, as an RPLIDAR's",
        "the scans have no stamps: they are taken as 0.1 s apart",
        "the units are not stated: angles are taken as deg, distances as mm",
    ]


@pytest.mark.parametrize(
    ("header", "rows", "bearings", "ranges", "stamp_ns"),
    [
        ("angle_rad,range_m", "0,1\n1,2\n2,3\n", [0, 1, 2], [1, 2, 3], 0),
        ("angle;distance", "0;1\n1;2\n2;3\n", [0, 1, 2], [1, 2, 3], 0),
        ("Time; Angle (rad); Distance (m)", "1,5; 0,5; 1,25\n1,5; 1; 2\n", [0.5, 1], [1.25, 2], 1_500_000_000),
        ("t, angle [deg], range [mm]", "2, 0, 1000\n2, 90, 2000\n", [0, np.pi / 2], [1, 2], 2_000_000_000),
        ("Angle (°)\tDistance (mm)", "0\t1000\n90\t2000\n", [0, np.pi / 2], [1, 2], 0),
        ("azimuth_deg\tr", "0\t1\n90\t2\n", [0, np.pi / 2], [1, 2], 0),
        ("timestamp_ms theta[deg] dist(cm)", "1500 0 100\n1500 90 200\n", [0, np.pi / 2], [1, 2], 1_500_000_000),
        ("time,angle,dist", "1700000000000000001,180,500\n1700000000000000001,90,500\n", [np.pi, np.pi / 2], [0.5, 0.5],
         1700000000000000001),
        ("stamp,angle_deg,distance_in", "1700000000123,0,100\n1700000000123,90,50\n", [0, np.pi / 2], [2.54, 1.27],
         1_700_000_000_123_000_000),
        ("time,angle_deg,r_ft", "1700000000123456,0,10\n1700000000123456,90,5\n", [0, np.pi / 2], [3.048, 1.524],
         1_700_000_000_123_456_000),
        ("theta: 0.00 Dist: 01000.00 Q: 47", "theta: 90.00 Dist: 02000.00 Q: 47\n", [0, -np.pi / 2], [1, 2], 0),
    ],
)  # fmt: skip
def test_units_are_those_of_the_names(tmp_path, header, rows, bearings, ranges, stamp_ns):
    ((_, scan),), _ = read(tmp_path, f"{header}\n{rows}")
    np.testing.assert_allclose(scan.geometry.bearings, bearings)
    np.testing.assert_allclose(scan.ranges, ranges)
    assert scan.stamp_ns == stamp_ns


def test_a_scan_ends_where_the_angle_starts_over(tmp_path):
    """Whatever other columns say; the log begins within a turn."""
    rows = [f"{int(angle == 0)},{angle},1\n" for angle in range(0, 360, 10)]
    back, _ = read(tmp_path, "rev,angle_deg,distance_m\n" + "".join(rows[20:] + 3 * rows))
    assert [len(scan) for _, scan in back] == [16, 36, 36, 36]


def test_angles_in_order_stay_so_over_a_gap_of_more_than_half_a_turn(tmp_path):
    angles = [*range(0, 81, 2), *range(280, 359, 2)]
    back, _ = read(tmp_path, "angle_deg,distance_m\n" + 2 * "".join(f"{angle},1\n" for angle in angles))
    assert len(back) == 2
    for _, scan in back:
        np.testing.assert_allclose(np.degrees(scan.geometry.bearings), angles)


def test_a_degree_sign_in_another_encoding_is_one(tmp_path):
    ((_, scan),), _ = read(tmp_path, "angle [°],dist [m]\n1,1\n2,1\n".encode("latin-1"))
    np.testing.assert_allclose(np.degrees(scan.geometry.bearings), [1, 2])


ROSTOPIC = rostopic_rows(SCANS).decode()
ECHO = echo_rows(SCANS).decode()


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        ("t,angle_deg,dist_mm\n0,1,x\n", 2, "column dist_mm: expected a number, got 'x'"),
        ("t,angle_deg,dist_mm\n0,nan,1\n", 2, "column angle_deg: expected a finite angle"),
        ("t,angle_deg,dist_mm\n0,1\n", 2, "expected 3 values"),
        ("t,angle_deg,dist_mm\nx,1,1\n", 2, "column t: expected a stamp"),
        ("t,angle_rad,dist_mm\n0,0,1\n0,100,1\n0,200,1\n", 4, "look like degrees"),
        ("t,angle_deg,dist_mm\n0,5,1\n0,5,1\n0,5,1\n", 4, "all point one way"),
        ("t,angle_deg,dist_mm\n", None, "expected a row for each scan, got none"),
        (ROSTOPIC.replace("field.angle_increment", "field.angle_step"), 1, "none named angle_increment"),
        (ROSTOPIC.replace(",laser,", ",laser,1,", 1), 2, "cells as in the first line"),
        (ECHO.replace("\n", ",...\n", 1), 1, "--full-length"),
        (ECHO + "1,2,laser,1\n", len(SCANS) + 1, "expected a LaserScan in each row"),
        (ECHO.replace(",\n", ",1,1,1\n", 1), 1, f"expected {len(SCANS[0].scan)} ranges"),
        ("1,2,3,4,5,6,7,8,9,10,11,12,13\n" * 50, 1, "ranges by the angles, and as many intensities or none, got 3"),
        ("1,2,3,4,4,6,7,8,9,10,11,12,13\n" * 50, 1, "expected 1 ranges by the angles"),
        (ROSTOPIC.replace("laser,-", "laser,x", 1), 2, "column angle_min: expected a number"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, problem):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert problem in str(caught.value)
    assert caught.value.line == line


def test_contradicting_angles_are_refused_as_in_bags(tmp_path):
    lines = ROSTOPIC.splitlines()
    cells = lines[1].split(",")
    cells[lines[0].split(",").index("field.angle_max")] = "0.1"
    with pytest.raises(InputError, match=r"line 2: expected angles in rad that fit each other.*not at angle_max 0\.1"):
        read(tmp_path, "\n".join([lines[0], ",".join(cells), ""]))
