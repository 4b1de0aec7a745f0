"""Each kind of bad log gets its clear line."""

from __future__ import annotations

import bz2
import gzip

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.csv import CsvLog, write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry

GOOD = "FLASER 2 1.0 2.0 0 0 0 0 0 0 1.0 host 0.1\n"


@pytest.fixture
def problem(tmp_path):
    """Message and line of the error that reading gives."""

    def reader(content, **options):
        path = tmp_path / "bad.log"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(InputError) as caught:
            list(CarmenLog(path, **options))
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
        return str(caught.value), caught.value.line

    return reader


def long_log(scans):
    rng = np.random.default_rng(1)
    rows = np.round(rng.uniform(0.1, 80, (scans, 180)), 2)
    lines = (f"FLASER 180 {' '.join(map(str, row))} 0 0 0 0 0 0 {i}.0 host 0\n" for i, row in enumerate(rows))
    return "".join(lines).encode()


def test_missing_and_folder(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        CarmenLog(tmp_path / "absent.log")
    with pytest.raises(InputError, match="expected a file, got a directory"):
        CarmenLog(tmp_path)


@pytest.mark.parametrize("content", [b"", gzip.compress(b"", mtime=0), bz2.compress(b""), b"\n\n"])
def test_empty(problem, content):
    message, _ = problem(content)
    assert "empty" in message or "got no scan" in message


@pytest.mark.parametrize("content", [bytes(range(256)) * 9, b"\x89PNG\r\n\x1a\n\0", gzip.compress(b"\0\1\2", mtime=0)])
def test_binary(problem, content):
    assert "binary" in problem(content)[0]


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ("FLASER", "expected a whole FLASER line"),
        ("FLASER 2 1.0", "expected a whole FLASER line"),
        ("FLASER x 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "word 2 of a FLASER line, got 'x'"),
        ("FLASER 2.5 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "whole number as word 2"),
        ("FLASER -2 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "whole number as word 2"),
        ("FLASER inf 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "whole number as word 2"),
        ("FLASER 0 0 0 0 0 0 0 1.0 host 0", "at least one reading"),
        ("FLASER 3 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "1 values too few"),
        ("FLASER 1 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "1 values too many"),
        ("FLASER 8 1.0 2.0 0 0 0 0 0 0 1.0 host 0", "expected six pose values"),
        ("FLASER 2 1.0 two 0 0 0 0 0 0 1.0 host 0", "word 4 of a FLASER line, got 'two'"),
        ("FLASER 2 1.0 0x2 0 0 0 0 0 0 1.0 host 0", "word 4 of a FLASER line, got '0x2'"),
        ("FLASER 2 1.0 2.0 0 0 0 nan 0 0 1.0 host 0", "finite x y theta"),
        ("FLASER 2 1.0 2.0 0 0 0 0 0 inf 1.0 host 0", "finite x y theta"),
        ("FLASER 2 1.0 2.0 0 0 0 1e308 0 0 1.0 host 0", "finite x y theta of less than 1e+09"),
        ("FLASER 2 1.0 2.0 0 -1e9 0 0 0 0 1.0 host 0", "finite x y theta of less than 1e+09"),
        ("FLASER 2 1.0 2.0 0 0 0 0 0 0 soon host 0", "expected a stamp"),
        ("FLASER 2 1.0 2.0 0 0 0 0 0 0 nan host 0", "expected a stamp"),
        ("ROBOTLASER1 0 -1 2 1 30 0 0 3 1 1 1 0 1 0 0 1 0 0 0 0 0 0 1.0 host 0", "1 values too few"),
        ("ROBOTLASER1 0 -1 2 0 30 0 0 2 1 1 0 1 0 0 1 0 0 0 0 0 0 0 1.0 host 0", "positive angular resolution"),
        ("ROBOTLASER1 0 -1 2 1.0 host 0", "whole number as word 9"),
        ("REMISSIONFLASER 2 1 9 2 1.0 host 0", "1 values too few"),
    ],
)
@pytest.mark.parametrize("good_after", [0, 3])
def test_malformed_line(problem, bad, expected, good_after):
    message, line = problem(GOOD * 4 + bad + "\n" + GOOD * good_after)
    assert expected in message
    assert line == 5


def test_odometry_that_a_scan_needs(problem):
    scan = "REMISSIONFLASER 1 1.0 9 1.0 host 0\n"
    after = "0 0 0 1.0 host 0"
    for values in (f"0 inf 0 {after}", f"1e9 0 0 {after}", f"0 0 x {after}", "0 0 0", "0 0 0 0 0 0 x h 0"):
        odometry = f"ODOM {values}"
        message, line = problem(f"{scan}{odometry}\n{scan}")
        assert line == 2
        assert "expected" in message


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
def test_cut_off_file_is_refused_with_its_scans_or_kept(tmp_path, problem, compress):
    whole = compress(long_log(3000))
    cut = whole[: len(whole) * 3 // 4]
    path = tmp_path / "cut.log"
    path.write_bytes(cut)
    log = CarmenLog(path, keep_truncated=True)
    kept = list(log)
    # bzip2 gives whole blocks of 900 kB, of the 2.6 MB here; gzip all but the last some bytes.
    assert 1000 < len(kept) < 2300
    assert [m.scan.stamp_ns for m in kept] == [i * 10**9 for i in range(len(kept))]
    assert log.statistics.truncated
    assert f"cut off; {len(kept)} scans" in problem(cut)[0]


@pytest.mark.parametrize("keep", range(1, 39))
def test_last_line_cut_anywhere(tmp_path, problem, keep):
    """From its tag up to its host: what remains is no whole line."""
    assert GOOD[:39] == "FLASER 2 1.0 2.0 0 0 0 0 0 0 1.0 host 0"
    content = GOOD * 3 + GOOD[:keep]
    message, _ = problem(content)
    assert "the last line is cut off" in message
    assert "3 scans" in message
    path = tmp_path / "cut.log"
    path.write_text(content)
    log = CarmenLog(path, keep_truncated=True)
    assert len(list(log)) == 3
    assert log.statistics.truncated


@pytest.mark.parametrize("last", [GOOD.rstrip("\n"), "ODOM 0 0 0 0 0 0 1.0 host 0", "# end"])
def test_a_whole_last_line_needs_no_line_end(tmp_path, last):
    path = tmp_path / "log"
    path.write_text(GOOD + last)
    log = CarmenLog(path)
    assert len(list(log)) == 1 + last.startswith("FLASER")
    assert not log.statistics.truncated


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    """A short log with every column in use."""
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    mounting = np.eye(4)
    mounting[:3, 3] = 0.1, 0.2, 0.3
    geometries = [ScanGeometry(-1 + 0.5 * np.arange(n), mounting) for n in (5, 4)]
    write_csv_log(
        path,
        (
            Measurement(
                Odometry.at(k * 10**8 + 5, [0.1 * k, 0, 0.01 * k]),
                LaserScan.from_ranges(
                    k * 10**8,
                    [1.25, 2, np.inf, np.nan, 3][: 5 - k % 2],
                    geometries[k % 2],
                    range_min_m=0.1,
                    range_max_m=10,
                    beam_times_s=1e-3 * np.arange(5 - k % 2),
                ),
            )
            for k in range(6)
        ),
    )
    return path.read_bytes()


@pytest.mark.parametrize("share", np.linspace(0.05, 0.99, 12))
def test_a_log_that_ends_anywhere_is_refused_or_read_so_far(tmp_path, whole, share):
    path = tmp_path / "log.csv"
    cut = whole[: int(share * len(whole))]
    path.write_bytes(cut)
    with pytest.raises(InputError, match="cut off"):
        list(CsvLog(path))
    log = CsvLog(path, keep_truncated=True)
    rows = cut.count(b"\n") - 1
    if rows < 1:
        with pytest.raises(InputError, match="a row for each scan"):
            list(log)
    else:
        assert [m.scan.stamp_ns for m in log] == [k * 10**8 for k in range(rows)]
        assert log.statistics.truncated
