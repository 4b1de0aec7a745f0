"""Trajectories in CSV, with the covariance of each pose."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridslam.errors import InputError
from gridslam.io.trajectories import CSV_HEADER, read_trajectory_csv, write_trajectory_csv
from gridslam.types import Trajectory

ROW = "1.5,1,2,3,1,0,0,1,0,1"
metres = st.floats(-1e4, 1e4)
rows = st.tuples(
    st.integers(-(10**18), 4 * 10**18),
    metres,
    metres,
    st.floats(-np.pi, np.pi, exclude_max=True),
    st.lists(st.floats(-1e3, 1e3), min_size=9, max_size=9),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=50)
@given(st.lists(rows, min_size=1, max_size=10))
def test_round_trip(tmp_path, given_rows):
    stamps = np.array([row[0] for row in given_rows])
    poses = np.array([row[1:4] for row in given_rows])
    roots = np.array([row[4] for row in given_rows]).reshape(-1, 3, 3)
    covariances = roots @ roots.transpose(0, 2, 1)
    write_trajectory_csv(tmp_path / "t.csv", Trajectory(stamps, poses), covariances)
    back, spread = read_trajectory_csv(tmp_path / "t.csv")
    assert back.stamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(back.poses[:, :2], poses[:, :2], rtol=0, atol=0.6e-9)  # nine decimals
    assert np.abs(np.angle(np.exp(1j * (back.poses[:, 2] - poses[:, 2])))).max() < 0.6e-9
    assert ((back.poses[:, 2] >= -np.pi) & (back.poses[:, 2] < np.pi)).all()
    np.testing.assert_allclose(spread, covariances, rtol=0.6e-8, atol=0)  # nine significant digits


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", None),
        (f"{ROW}\n", 1),
        (f"{CSV_HEADER}\n", None),
        (f"{CSV_HEADER}\n{ROW}\n{ROW},1\n", 3),
        (f"{CSV_HEADER}\n{ROW[:-2]}\n", 2),
        (f"{CSV_HEADER}\n{ROW}\n\n", 3),
        (f"{CSV_HEADER}\nx{ROW}\n", 2),
        (f"{CSV_HEADER}\n{ROW}\n1.5,1,2,3,1,0,0,1,0,nan\n", 3),
        (f"{CSV_HEADER}\n{ROW}\n1.5,1,2,3,1,0,0,1,0,y\n", 3),
    ],
    ids=["empty", "no header", "no row", "too many", "too few", "blank", "stamp", "nan", "word"],
)
def test_bad_files(tmp_path, text, line):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_trajectory_csv(tmp_path / "t.csv")
    assert caught.value.line == line
