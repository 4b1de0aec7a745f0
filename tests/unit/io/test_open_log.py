"""The format of a log is told by its content, and what is none is told from what it looks like."""

import bz2
import gzip

import pytest

from gridslam.errors import InputError
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.csv import CsvLog
from gridslam.io.log import LogFormat, LogOptions, detect_log_format, open_log
from gridslam.io.selection import SelectedLog
from gridslam.io.trajectories import CSV_HEADER

CARMEN = b"# a drive\nPARAM robot_length 0.5 host 1.0\nFLASER 1 1.0 0 0 0 0 0 0 1.0 host 1.0\n"
CSV = b"# a drive\n\nstamp_s,angle_min_rad,angle_increment_rad,ranges_m\n"


@pytest.mark.parametrize("compress", [bytes, gzip.compress, bz2.compress])
@pytest.mark.parametrize(
    ("content", "form"),
    [
        (CARMEN, LogFormat.CARMEN),
        (b"SYNC 1\n" * 1000 + b"\n \n" + CARMEN, LogFormat.CARMEN),
        (b"ODOM 1 2", LogFormat.CARMEN),
        (CSV, LogFormat.CSV),
        (b"\xef\xbb\xbf" + b"ranges_m;stamp_s\r\n", LogFormat.CSV),
        (b'"stamp_s","ranges"\n', LogFormat.CSV),
    ],
)
def test_text_whatever_its_name_is(tmp_path, content, form, compress):
    path = tmp_path / "log.bag"
    path.write_bytes(compress(content))
    assert detect_log_format(path) is form


@pytest.mark.parametrize("head", [b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\x00", b"\x28\xb5\x2f\xfd"])
def test_bags(tmp_path, head):
    (tmp_path / "log.txt").write_bytes(head + bytes(100))
    assert detect_log_format(tmp_path / "log.txt") is LogFormat.BAG


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "the file is empty"),
        (b"PK\x03\x04" + bytes(50), "got a zip archive"),
        (b"\x89PNG\r\n\x1a\n" + bytes(50), "got a picture"),
        (bytes(257) + b"ustar" + bytes(500), "got a tar archive"),
        (b"\x01\x02\x03\x00rest", "got binary data that begins with 01 02 03 00 72 65 73 74"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "got a pointer of Git LFS"),
        (b"#ROSRECORD V1.2\n" + bytes(50), "got a ROS 1 bag of the old format V1 (rosbag filter OLD.bag"),
        (b"#ROSLOG V1.1\n" + bytes(50), "got a ROS 1 bag of the old format V1 (rosbag filter OLD.bag"),
        (b"(15, 1.5, 300.0)\n", "numbers without a line of names (such as angle_deg,dist_mm)"),
        (b"0.000000000000000000e+00 1.5E-01 inf -NaN\n", "numbers without a line of names (such as angle_deg,dist_mm)"),
        (b"1.5,300,\n", "numbers without a line of names (such as angle_deg,dist_mm)"),
        (b"1.5\t300\n", "numbers without a line of names (such as angle_deg,dist_mm)"),
        (b"header: \n  seq: 7\n", "got messages as text (the table of rostopic echo -p -b BAG /scan is read"),
        (b"# stamp x y\n1.5 0 0 0 0 0 0 1\n", "got poses without scans"),
        (CSV_HEADER.encode() + b"\n", "got poses without scans"),
        (b"VERTEX_SE2 0 0 0 0\n", "got a pose graph (gridslam graph solves it)"),
        (b"<!DOCTYPE html>\n", "got a web page"),
        (b"dear diary,\nFLASERS are\n", "got text that begins with 'dear diary,'"),
        (b"# nothing\n\n", "got text with blank lines only"),
        (gzip.compress(b"#ROSBAG V2.0\n" + bytes(50), mtime=0), "got a compressed one (unpack it)"),
    ],
)
def test_what_is_no_log_is_told_in_one_line(tmp_path, content, problem):
    path = tmp_path / "log.clf"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        open_log(path)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_folders_and_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match=r"got a folder without metadata\.yaml, \.db3 or \.mcap"):
        open_log(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        open_log(tmp_path / "absent")


def test_the_reader_and_its_options(tmp_path):
    (tmp_path / "a").write_bytes(CARMEN)
    (tmp_path / "b").write_bytes(CSV)
    carmen, scans = open_log(tmp_path / "a", LogOptions(keep_truncated=True)), open_log(tmp_path / "b")
    assert isinstance(carmen, CarmenLog)
    assert carmen.keep_truncated
    assert isinstance(scans, CsvLog)
    assert isinstance(open_log(tmp_path / "a", LogOptions(every=2)), SelectedLog)
    for options in (LogOptions(odometry_topic="/odom"), LogOptions(odometry_frame="odom"), LogOptions(base_frame="b")):
        with pytest.raises(InputError, match="chosen in bags alone, and this is a CSV log"):
            open_log(tmp_path / "b", options)


def test_a_log_damaged_from_its_start_is_told_so(tmp_path):
    path = tmp_path / "log.clf.bz2"
    path.write_bytes(bz2.compress(CARMEN)[:30])
    with pytest.raises(InputError, match="cut off"):
        list(open_log(path))
