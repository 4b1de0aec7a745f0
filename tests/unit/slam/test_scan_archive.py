"""The archive of scans: what goes in comes out, to the 65,000th part of the farthest end, also by way of arrays."""

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import StoredScan


def scans(count=9):
    """Some without a beam; each from a laser of its own place."""
    rng = np.random.default_rng(0)
    return [StoredScan(rng.uniform(-100, 100, (7 * (k % 4), 2)), rng.normal(size=2)) for k in range(count)]


@pytest.fixture
def archive():
    kept = ScanArchive()
    for k, scan in enumerate(scans()):
        kept.append(scan, np.array([0.1 * k, 0.0, 0.0]), is_key=k in (0, 3, 5))
    return kept


def contents(archive):
    return {name: (array.dtype, array.shape, array.tobytes()) for name, array in archive.to_arrays().items()}


def test_what_goes_in_comes_out(archive):
    """A coordinate is rounded to a step, which is the greatest one's 32,767th part."""
    assert len(archive) == 9
    assert archive.keys == [0, 3, 5]
    for k, scan in enumerate(scans()):
        half = 0.5 * np.abs(scan.ends).max(initial=0.0) / 32767
        assert archive[k].ends.dtype == np.float64
        np.testing.assert_allclose(archive[k].ends, scan.ends, rtol=1e-12, atol=half)
        if len(scan.ends):
            np.testing.assert_array_equal(archive[k].origin, scan.origin)
            assert archive[k].reach_m == pytest.approx(scan.reach_m, abs=2 * half)
        assert len(archive[k]) == len(scan.ends)
    for key, scan in enumerate((0, 3, 5)):
        np.testing.assert_array_equal(archive.key(key).ends, archive[scan].ends)
    assert archive.nbytes == 4 * sum(len(scan.ends) for scan in scans())


@pytest.mark.parametrize("length_m", [0.0, 5e-324, 1e-3])
def test_ends_near_the_origin_move_by_half_a_step_at_most(length_m):
    """Those at the origin, and those nearer to it than any step that can be represented, have steps of 1 m."""
    ends = length_m * np.arange(-20.0, 20).reshape(-1, 2)
    kept = ScanArchive()
    kept.append(StoredScan(ends, np.zeros(2)), np.zeros(3), is_key=True)
    np.testing.assert_allclose(kept[0].ends, ends, rtol=1e-12, atol=0.5 * np.abs(ends).max() / 32767 or 1e-300)


@pytest.mark.parametrize(
    "change",
    [
        {"stored": np.array([0, 0, 2, 3, 5, 6, 7])},
        {"stored": np.array([0, 1, 2, 3, 6, 5, 7])},
        {"stored": np.array([0, 1, 2, 3, 5, 6, 9])},
        {"stored": np.array([-(2**63), 1, 2, 3, 5, 6, 7])},
        {"keys": np.array([0, 4, 5])},
    ],
)
def test_arrays_that_contradict_each_other_are_refused(archive, change):
    arrays = archive.to_arrays()
    assert arrays["stored"].tolist() == [0, 1, 2, 3, 5, 6, 7]
    with pytest.raises(ArgumentError, match="keys: expected ascending scans below 9, the key scans among them"):
        ScanArchive.from_arrays(arrays | change)


@pytest.mark.parametrize("count", [-1, 10**15])
def test_a_number_of_scans_that_cannot_be_is_refused(archive, count):
    with pytest.raises(ArgumentError, match="count: expected numbers from 0 to 100000000"):
        ScanArchive.from_arrays(archive.to_arrays() | {"count": np.array(count)})


@pytest.mark.parametrize(
    "others",
    [
        ScanArchive.snapshot,
        lambda archive: followed_by(ScanArchive(), archive),
        lambda archive: followed_by(of_one_scan(), archive),
    ],
)
def test_archives_that_share_scans_go_on_apart(archive, others):
    """None writes where the other does."""
    other = others(archive)
    before = [[kept[k].ends for k in range(len(kept))] for kept in (archive, other)]
    near, far = scans()[1], StoredScan(-scans()[1].ends, np.ones(2))
    for _ in range(2):
        archive.append(near, np.zeros(3), is_key=True)
        other.append(far, np.zeros(3), is_key=True)
    for kept, scan, shared in zip((archive, other), (near, far), before, strict=True):
        assert all(np.array_equal(kept[k].ends, ends) for k, ends in enumerate(shared))
        for key in (-2, -1):
            np.testing.assert_allclose(kept.key(key).ends, scan.ends, atol=0.01)
        assert contents(ScanArchive.from_arrays(kept.to_arrays())) == contents(kept)


def of_one_scan():
    kept = ScanArchive()
    kept.append(scans()[3], np.zeros(3), is_key=True)
    return kept


def followed_by(first, later):
    first.extend(later)
    return first


def test_where_there_is_no_memory_for_a_scan_none_is_lost(archive, monkeypatch):
    """It goes on, with the same scans, once there is memory."""

    def fail(*arguments):
        raise MemoryError

    before = contents(archive)
    with monkeypatch.context() as patched:
        patched.setattr("gridslam.slam.loop_closure.scan_archive._Stored", fail)
        with pytest.raises(MemoryError):
            archive.append(scans()[1], np.zeros(3), is_key=True)
    assert contents(archive) == before
    archive.append(scans()[2], np.zeros(3), is_key=True)
    np.testing.assert_allclose(archive.key(-1).ends, scans()[2].ends, atol=0.01)


@pytest.mark.parametrize("name", ["ends", "steps_m", "origins", "ends.counts"])
def test_arrays_that_do_not_fit_are_refused(archive, name):
    arrays = archive.to_arrays()
    with pytest.raises(ArgumentError, match=r"ends|steps_m|origins"):
        ScanArchive.from_arrays(arrays | {name: arrays[name][:-1]})
    del arrays[name]
    with pytest.raises(ArgumentError, match=f"an array named {name}"):
        ScanArchive.from_arrays(arrays)
