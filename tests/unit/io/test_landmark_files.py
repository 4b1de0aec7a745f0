"""Files of landmarks."""

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.landmarks import LANDMARKS_HEADER, read_landmarks, write_landmarks
from gridslam.slam.landmarks.report import LandmarkMap


@pytest.mark.parametrize("count", [0, 1, 7])
def test_what_is_written_is_read(tmp_path, count):
    rng = np.random.default_rng(count)
    roots = rng.normal(size=(count, 2, 2))
    told = LandmarkMap(
        rng.permutation(100)[:count].astype(np.int64),
        rng.normal(0, 50, (count, 2)),
        roots @ roots.swapaxes(1, 2),
        rng.integers(1, 99, count),
    )
    write_landmarks(tmp_path / "a.csv", told)
    found = read_landmarks(tmp_path / "a.csv")
    assert found.names.tolist() == told.names.tolist()
    assert found.observations.tolist() == told.observations.tolist()
    np.testing.assert_allclose(found.positions, told.positions, atol=1e-9)
    np.testing.assert_allclose(found.covariances, told.covariances, rtol=1e-8)
    assert len(found) == count


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n", "line 1: expected the columns"),
        (LANDMARKS_HEADER + "\n1,2,3,4,5,6\n", r"line 2: expected 7 numbers \(landmark,x_m.*\), got 6"),
        (LANDMARKS_HEADER + "\n1,2,3,4,5,6,7\n1,2,x,4,5,6,7\n", "line 3: expected numbers"),
        (LANDMARKS_HEADER + "\n1.5,2,3,4,5,6,7\n", "line 2: expected whole numbers"),
        (LANDMARKS_HEADER + "\n" + "9" * 30 + ",2,3,4,5,6,7\n", "line 2: expected whole numbers"),
        (LANDMARKS_HEADER + "\n1,2,nan,4,5,6,7\n", "line 2: expected finite numbers"),
    ],
)
def test_bad_files(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_landmarks(tmp_path / "a.csv")
