"""The archive of scans: what goes in comes out, to a hundredth of a millimetre, also by way of arrays."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.slam.scan_archive import ScanArchive
from gridslam.types import EndPoints


def scans(count=9):
    """Some without a beam; each from a laser of its own place."""
    rng = np.random.default_rng(0)
    return [EndPoints(rng.uniform(-100, 100, (7 * (k % 4), 2)), rng.normal(size=2)) for k in range(count)]


@pytest.fixture
def archive():
    kept = ScanArchive()
    for k, scan in enumerate(scans()):
        kept.append(scan, np.array([0.1 * k, 0.0, 0.0]), is_key=k in (0, 3, 5))
    return kept


def contents(archive):
    return {name: (array.dtype, array.shape, array.tobytes()) for name, array in archive.to_arrays().items()}


def test_what_goes_in_comes_out(archive):
    """A float32 below 128 m is a multiple of 2^-17 m: rounding moves it by 4e-6 m at most."""
    assert len(archive) == 9
    assert archive.keys == [0, 3, 5]
    for k, scan in enumerate(scans()):
        assert archive[k].ends.dtype == np.float64
        np.testing.assert_allclose(archive[k].ends, scan.ends, rtol=0, atol=2.0**-18)
        np.testing.assert_array_equal(archive[k].origin, scan.origin)
        assert len(archive[k]) == len(scan.ends)
        assert archive[k].reach_m == pytest.approx(scan.reach_m, abs=1e-5)
    for key, scan in enumerate((0, 3, 5)):
        np.testing.assert_array_equal(archive.key(key).ends, archive[scan].ends)
    assert archive.nbytes == 8 * sum(len(scan.ends) for scan in scans())


def test_of_a_robot_that_stands_nothing_is_kept():
    """But of every key scan, and of what was seen from 2 cm or 0.01 rad away from the last scan that was kept."""
    scan, kept = scans()[1], ScanArchive()
    poses = [0.0, 0.0, 0.01, 0.019, 0.021, 0.03, 0.041, 0.041]
    for k, x in enumerate(poses):
        kept.append(scan, np.array([x, 0.0, 0.0]), is_key=k == 1)
    assert [len(kept[k]) > 0 for k in range(8)] == [True, True, False, False, True, False, True, False]
    kept.append(scan, np.array([0.041, 0.0, 0.011 + 2 * np.pi]), is_key=False)
    assert len(kept[8]) == len(scan)
    assert kept.nbytes == 5 * 8 * len(scan)


def test_what_was_given_may_be_changed_afterwards():
    scan, kept = scans()[1], ScanArchive()
    kept.append(scan, np.zeros(3), is_key=True)
    before = contents(kept)
    scan.ends[:] = 7.0
    kept[0].ends[:] = 8.0
    assert contents(kept) == before


def test_a_snapshot_goes_its_own_way(archive):
    twin, before = archive.snapshot(), contents(archive)
    twin.append(scans()[1], np.zeros(3), is_key=True)
    assert contents(archive) == before
    assert (len(twin), twin.keys) == (10, [0, 3, 5, 9])
    archive.append(scans()[2], np.zeros(3), is_key=False)
    assert (len(twin), twin.keys) == (10, [0, 3, 5, 9])


def test_arrays_go_on_as_the_archive_does(archive):
    read = ScanArchive.from_arrays(archive.to_arrays())
    assert contents(read) == contents(archive)
    for one in (read, archive):
        one.append(scans()[3], np.zeros(3), is_key=False)
    assert contents(read) == contents(archive)
    assert contents(ScanArchive.from_arrays(ScanArchive().to_arrays())) == contents(ScanArchive())


@pytest.mark.parametrize("name", ["ends", "origins", "counts"])
def test_arrays_that_do_not_fit_are_refused(archive, name):
    arrays = archive.to_arrays()
    with pytest.raises(ArgumentError, match="ends"):
        ScanArchive.from_arrays(arrays | {name: arrays[name][:-1]})
    del arrays[name]
    with pytest.raises(KeyError, match=name):
        ScanArchive.from_arrays(arrays)
