"""record.npz."""

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.results.record import RecordFlag, RecordWriter, read_record
from gridslam.types import SkipReason, StepReport


def report(stamp_ns, n=3, seed=0, **more):
    rng = np.random.default_rng(seed)
    defaults = {"poses": rng.normal(size=(n, 3)), "log_weights": rng.normal(size=n), "n_eff": 1.5, "best": n - 1}
    return StepReport(stamp_ns, np.zeros(3), np.eye(3), np.zeros(3), **(defaults | more))


def test_round_trip(tmp_path):
    reports = [
        report(10**18, seed=1),
        report(5, seed=2, parents=np.array([0, 0, 2]), lost=True),
        report(7, seed=3, degenerate_direction=np.array([1.0, 0.0])),
    ]
    writer = RecordWriter()
    for i, step in enumerate(reports):
        writer.add(step, 0.001 * i)
        writer.add(report(9, skipped=SkipReason.BETWEEN_KEY_SCANS), 1.0)
    writer.write(tmp_path / "record.npz")
    record = read_record(tmp_path / "record.npz")
    assert len(record) == 3
    assert record.stamps_ns.tolist() == [10**18, 5, 7]
    np.testing.assert_array_equal(record.poses, np.array([r.poses for r in reports], dtype=np.float32))
    np.testing.assert_array_equal(record.log_weights, [r.log_weights for r in reports])
    assert record.parents.tolist() == [[0, 1, 2], [0, 0, 2], [0, 1, 2]]
    assert record.best.tolist() == [2, 2, 2]
    assert record.flags.tolist() == [0, RecordFlag.LOST | RecordFlag.RESAMPLED, RecordFlag.UNDETERMINED]
    assert record.latency_s.tolist() == [0.0, 0.001, 0.002]
    assert record.n_eff.tolist() == [1.5] * 3


def test_bad_records(tmp_path):
    writer = RecordWriter()
    writer.add(report(1), 0.0)
    path = tmp_path / "r.npz"
    writer.write(path)
    whole = path.read_bytes()
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "other.npz", **(arrays | {"schema": np.array("other/1")}))
    np.savez(tmp_path / "shape.npz", **(arrays | {"n_eff": np.zeros(2)}))
    np.savez(tmp_path / "lacking.npz", **{name: arrays[name] for name in arrays if name != "poses"})
    np.save(tmp_path / "one.npz", np.zeros(3))
    (tmp_path / "one.npz.npy").rename(tmp_path / "one.npz")
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npz").write_text("text")
    (tmp_path / "empty.npz").touch()
    for name in ("other", "shape", "lacking", "one", "cut", "text", "empty", "none"):
        with pytest.raises(InputError, match=f"{name}.npz"):
            read_record(tmp_path / f"{name}.npz")


def test_tracked_revisits_are_kept_and_a_record_without_them_has_none(tmp_path):
    writer = RecordWriter()
    for stamp_ns in range(3):
        writer.add(report(stamp_ns), 0.0)
    writer.write(tmp_path / "r.npz", np.array([[0, 2], [1, 2]]))
    assert read_record(tmp_path / "r.npz").revisits.tolist() == [[0, 2], [1, 2]]
    arrays = dict(np.load(tmp_path / "r.npz").items())
    np.savez(tmp_path / "none.npz", **{name: array for name, array in arrays.items() if name != "revisits"})
    assert read_record(tmp_path / "none.npz").revisits.shape == (0, 2)
    for wrong in ([[0, 3]], [[-1, 0]], [0, 1], [[0, 1, 2]]):
        np.savez(tmp_path / "wrong.npz", **(arrays | {"revisits": np.array(wrong, np.int32)}))
        with pytest.raises(InputError, match="revisits"):
            read_record(tmp_path / "wrong.npz")
