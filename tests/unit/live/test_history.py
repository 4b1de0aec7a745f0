"""The map as it was, at any moment, in any order, in bounded memory."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import build, override
from gridslam.errors import InputError
from gridslam.live.history import History, PastReader
from gridslam.live.history_file import read_history, write_history
from gridslam.live.recorder import RunRecorder
from gridslam.live.tiles import TileReplica, split_into_tiles
from gridslam.pipeline import run
from support.loops import PROVOKED, loop_drive

RESAMPLING = override(PROVOKED, "when_to_resample.fraction=0.999")


def looks(replica):
    """All tiles that are known, by row and column."""
    at, tiles, _ = replica.since(0, 10**9)
    return {tuple(where): tile.tobytes() for where, tile in zip(at.tolist(), tiles, strict=True) if tile.any()}


def looks_of(grid):
    replica = TileReplica()
    replica.apply(split_into_tiles(grid))
    return looks(replica)


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements


def begin(recorder, most, source):
    """Record every key scan at first."""
    for number, measurement in enumerate(source):
        if number == 0:
            recorder.history = History(most, 1)
        yield measurement


def record(drive, *most):
    """Recorders, and of each key scan the map, the path and the pose as they were; the past is corrected."""
    recorders, seen = [RunRecorder(30.0) for _ in most], []
    source = drive
    for recorder, count in zip(recorders, most, strict=True):
        source = recorder.follow(source)
        source = begin(recorder, count, source)

    def note(report, state, seconds):
        if report.skipped is None:
            path = state.ancestry.trajectory(state.best)[:, :2]
            seen.append((looks_of(state.maps.occupancy(state.best)), path, np.array(report.pose), report.corrected))

    slam = replace(build(RESAMPLING), particles=4)
    run(source, slam, rng=np.random.default_rng(3), observers=[*recorders, note])
    return recorders, seen


@pytest.fixture(scope="module")
def recorded(drive):
    """A recorder that keeps every moment, one that keeps some 40, and what was to be seen."""
    (every, few), seen = record(drive, 10_000, 40)
    return {10_000: every, 40: few}, seen


@pytest.mark.parametrize("most", [10_000, 40])
def test_every_moment_is_as_it_was(recorded, most):
    recorders, seen = recorded
    recorder = recorders[most]
    history = recorder.history
    assert any(corrected for *_, corrected in seen), "the drive was to correct the past"
    assert len(history.moments) < (most if most > 40 else 40 * np.log2(len(seen) / 20 + 1))
    assert (history.interval > 1) == (most == 40)
    reader = PastReader(history)
    rng = np.random.default_rng(5)
    for index in [0, 1, len(history.moments) - 1, *rng.integers(0, len(history.moments), 25)]:
        moment = history.moments[index]
        tiles, path, pose, _ = seen[moment.keys - 1]
        found, frame = reader.read(moment.keys)
        assert found is moment
        assert looks(reader.replica) == tiles
        assert frame.path == pytest.approx(path, abs=1e-5)
        assert moment.pose == pytest.approx(pose)
        assert len(moment.scan) > 20
        assert history.find(moment.keys) == index
        assert history.find(moment.keys - 1) == index - 1
    assert len(history.closures) >= history.recognized > 0
    assert len(history.series) == len(seen)


def test_a_file_gives_the_same_moments(drive, tmp_path):
    history = record(drive[:150], 30)[0][0].history
    write_history(tmp_path / "history.npz", history)
    read = read_history(tmp_path / "history.npz")
    assert len(read.moments) == len(history.moments)
    for one, other in zip(history.moments, read.moments, strict=True):
        for a, b in zip(one, other, strict=True):
            assert np.array_equal(a, b)
        assert one.unpack() == other.unpack()
    assert (read.stamps_ns, read.scans) == (history.stamps_ns, history.scans)
    assert np.array_equal(read.series, history.series)
    assert read.describe(20) == history.describe(20)
    assert (tmp_path / "history.npz").stat().st_size < 400_000
    write_history(tmp_path / "none.npz", History())
    assert not read_history(tmp_path / "none.npz").moments


@pytest.fixture(scope="module")
def written(drive, tmp_path_factory):
    """The arrays of a short history."""
    path = tmp_path_factory.mktemp("written") / "history.npz"
    write_history(path, record(drive[:40], 30)[0][0].history)
    return dict(np.load(path).items())


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("schema", lambda array: np.array("gridslam.history/2"), "expected schema gridslam.history/3"),
        ("moments.keys", lambda array: array[::-1], "moments.keys: expected numbers of key scans in ascending order"),
        ("moments.keys", lambda array: array[:-1], "moments.stamp_ns: expected"),
        ("series", lambda array: -array, "series: expected figures from 0"),
        ("scans", lambda array: array[:-1], "scans: expected|series: expected"),
        ("closures", lambda array: np.array([[2, 1]]), "closures: expected pairs of key scans"),
        ("moments.pose", lambda array: array * np.nan, "moments.pose, .*: expected finite"),
        ("moments.first", lambda array: array + 1, "moments.first: expected"),
        ("moments.scan.counts", lambda array: -array, "moments.scan.counts: expected numbers >= 0"),
        ("moments.tiles", lambda array: array[::-1], "its arrays do not belong together: Error -3 while decompressing"),
        ("moments.at", lambda array: array.astype(np.int64), "moments.at: expected int32"),
        ("moments.at.counts", lambda array: array[[*range(1, len(array)), 0]], "expected [0-9]+ bytes of tiles, got"),
    ],
)
def test_files_that_are_none_are_refused(written, tmp_path, name, change, says):
    np.savez(tmp_path / "history.npz", **(written | {name: change(written[name])}))
    with pytest.raises(InputError, match=says):
        read_history(tmp_path / "history.npz")
