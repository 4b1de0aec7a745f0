"""A CSV that ends anywhere gives the scans before, or one clear line."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.csv import CsvLog, write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry


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
