"""Logs of landmarks: the real ones, small ones whose steps are known, and what is said of bad ones."""

import math

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.landmark_logs import LandmarkLog, MrclamLog, VictoriaParkLog, open_landmark_log
from gridslam.models.landmark import ObservationKind

ODOMETRY = "# Time v omega\n10.0 1.0 0.0\n10.1 1.0 0.0\n10.2 0.0 2.0\n10.3 0.0 0.0\n10.9 0.0 0.0\n"
MEASUREMENT = "# Time barcode range bearing\n10.05 14 1.5 0.25\n10.05 63 2.0 -0.5\n10.25 7 3.0 0.5\n10.25 99 3.0 0.5\n"
BARCODES = "1 14\n6 63\n8 7\n"
LANDMARKS = "6 1.0 2.0 0 0\n8 3.0 4.0 0 0\n"


@pytest.fixture
def mrclam(tmp_path):
    """Write a small dataset of one robot, with some of its files replaced, or left out where None."""

    def write(**replaced):
        files = {
            "Robot2_Odometry": ODOMETRY,
            "Robot2_Measurement": MEASUREMENT,
            "Barcodes": BARCODES,
            "Landmark_Groundtruth": LANDMARKS,
            "Robot2_Groundtruth": "10 0 0 0\n11 1 0 6.3\n",
            **replaced,
        }
        for name, text in files.items():
            if text is not None:
                (tmp_path / f"set_{name}.dat").write_text(text)
        return tmp_path / "set_Robot2_Odometry.dat"

    return write


@pytest.fixture
def park(tmp_path):
    def write(text):
        path = tmp_path / "park.txt"
        path.write_text(text)
        return path

    return write


def test_steps_of_mrclam_end_where_landmarks_are_seen(mrclam):
    assert isinstance(open_landmark_log(mrclam()), MrclamLog)
    log = MrclamLog(mrclam(), delay_ns=0)
    assert isinstance(log, LandmarkLog)
    assert (log.kind, log.stamped) == (ObservationKind.DEPTH_BEARING, True)
    for _ in range(2):  # each iteration reads anew
        steps = list(log)
        # The robot drives 1 m/s for 0.2 s and then turns at 2 rad/s for 0.1 s; the last step ends 0.25 s later at most.
        assert [step.stamp_ns for step in steps] == [10_050_000_000, 10_250_000_000, 10_900_000_000]
        np.testing.assert_allclose(steps[0].increment, [0.05, 0, 0], atol=1e-12)
        np.testing.assert_allclose(steps[1].increment, [0.15, 0, 0.1], atol=1e-12)
        np.testing.assert_allclose(steps[2].increment, [0, 0, 0.1], atol=1e-12)
        assert [step.observations.landmarks.tolist() for step in steps] == [[6], [8], []]
        assert steps[0].observations.values.tolist() == [[2.0, -0.5]]
        assert all(step.covariance is None for step in steps)
        found = log.statistics
        assert (found.odometry, found.steps, found.observations, found.robots, found.unknown) == (5, 3, 2, 1, 1)
        assert found.duration_s == pytest.approx(0.85)
    assert log.truth.landmarks.tolist() == [6, 8]
    assert log.truth.positions.tolist() == [[1, 2], [3, 4]]
    assert log.truth.trajectory.poses[1].tolist() == [1, 0, 6.3 - 2 * math.pi]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("Robot2_Odometry", "10.0 1.0\n", r"Odometry.dat, line 1: expected 3 numbers \(time_s v_m_s .*\), got 2"),
        ("Robot2_Odometry", "10.0 1.0 x\n", "Odometry.dat, line 1: expected numbers"),
        ("Robot2_Odometry", "10.0 1.0 nan\n", "Odometry.dat, line 1: expected finite numbers"),
        ("Robot2_Odometry", "10.0 1e300 1\n", r"Odometry.dat, line 1: expected speeds up to 1e\+09"),
        ("Robot2_Odometry", "#\n10 1 1\n9.9 1 1\n", "Odometry.dat, line 3: expected stamps in order, got 9.9"),
        ("Robot2_Measurement", "10.0 14 1.0 0.1 7\n", r"Measurement.dat, line 1: expected 4 numbers .*, got 5"),
        ("Robot2_Measurement", "10.0 1.5 1.0 0.1\n", "line 1: .* whole barcode"),
        ("Robot2_Measurement", "10.0 14 -1.0 0.1\n", "line 1: .* range above 0"),
        ("Robot2_Measurement", "10.0 14 1e308 0.1\n", r"line 1: .* range above 0 and up to 100000"),
        ("Robot2_Measurement", "10.0 14 1.0 4\n", "line 1: .* bearing within pi"),
        ("Robot2_Measurement", "10 63 1 0\n10 63 1 0\n", "line 2: subject 6 is seen twice"),
        ("Barcodes", "1 14 3\n", r"Barcodes.dat, line 1: expected 2 numbers \(subject barcode\), got 3"),
        ("Barcodes", "1 14\n2 14\n", "Barcodes.dat: .* each barcode once"),
        ("Landmark_Groundtruth", "6 1.0 2.0\n", r"Landmark_Groundtruth.dat, line 1: expected 5 numbers .*, got 3"),
        ("Landmark_Groundtruth", "# nothing\n", "Landmark_Groundtruth.dat: expected rows"),
        ("Landmark_Groundtruth", None, "expected set_Landmark_Groundtruth.dat .* beside it, got none"),
        ("Robot2_Measurement", None, "expected set_Robot2_Measurement.dat .* beside it, got none"),
        ("Robot2_Groundtruth", "10 0 0\n", "Groundtruth.dat, line 1: expected 4 numbers"),
    ],
)
def test_bad_files_of_mrclam(mrclam, name, text, said):
    path = mrclam(**{name: text})
    with pytest.raises(InputError, match=said):
        list(open_landmark_log(path))


def test_steps_of_victoria_park(park):
    path = park(
        "LANDMARK 3 9 1 2 0.5 0.1 0.6\nODOMETRY 3 5 1 0.1 0.2 1 0.1 0.2 2 0.3 3\nODOMETRY 5 6 1 0 0 1 0 0 1 0 1\n"
        "LANDMARK 6 7 3 4 1 0 1\nLANDMARK 6 9 5 6 1 0 1\n"
    )
    log = open_landmark_log(path)
    assert isinstance(log, VictoriaParkLog)
    assert isinstance(log, LandmarkLog)
    assert (log.kind, log.stamped, log.truth) == (ObservationKind.POSITION, False, None)
    first, second, third = log
    assert [step.stamp_ns for step in (first, second, third)] == [0, 10**9, 2 * 10**9]
    assert first.increment.tolist() == [0, 0, 0]
    assert first.observations.landmarks.tolist() == [9]
    assert first.observations.covariances.tolist() == [[[0.5, 0.1], [0.1, 0.6]]]
    assert second.increment.tolist() == [1, 0.1, 0.2]
    assert second.covariance.tolist() == [[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]]
    assert len(second.observations) == 0
    assert third.observations.landmarks.tolist() == [7, 9]
    assert third.observations.values.tolist() == [[3, 4], [5, 6]]
    assert (log.statistics.odometry, log.statistics.steps, log.statistics.observations) == (2, 3, 3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "ODOMETRY 0 1 1 0 0 1 0 0 1 0\n",
            "line 1: expected 'ODOMETRY from to x_m .* tt', got 'ODOMETRY 0 .*'",
        ),
        ("LANDMARK 0 1 1 0 1 0 1 2\n", "line 1: expected 'LANDMARK pose landmark x_m y_m xx xy yy', got"),
        ("LANDMARK 0 x 1 0 1 0 1\n", "line 1: expected 'LANDMARK pose .*', got 'LANDMARK 0 x 1 0 1 0 1'"),
        ("LANDMARK 0 1 nan 0 1 0 1\n", "line 1: LANDMARK: expected numbers up to 100000"),
        ("LANDMARK 0 1 1 0 1 2 1\n", "line 1: .* positive definite covariance"),
        ("LANDMARK 0 1 1 0 1 0 1\nEDGE 0 1\n", "line 2: expected ODOMETRY or LANDMARK, got 'EDGE'"),
        ("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nODOMETRY 0 2 1 0 0 1 0 0 1 0 1\n", "line 2: .* pose 1, .* got 0"),
        ("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 0 2 1 0 1 0 1\n", "line 2: expected a line of pose 1"),
        ("LANDMARK 0 1 1 0 1 0 1\nLANDMARK 0 1 1 0 1 0 1\n", "line 2: landmark 1 is seen twice"),
    ],
)
def test_bad_lines_of_victoria_park(park, text, said):
    with pytest.raises(InputError, match=said):
        list(open_landmark_log(park(text)))


def test_what_is_no_log_of_landmarks(park, tmp_path):
    with pytest.raises(InputError, match="got a line that begins with 'hello'"):
        open_landmark_log(park("# a\nhello\n"))
    with pytest.raises(InputError, match="no such file"):
        open_landmark_log(tmp_path / "none.txt")
    with pytest.raises(InputError, match="got a folder"):
        open_landmark_log(tmp_path)
    with pytest.raises(InputError, match="got none"):
        list(VictoriaParkLog(park("# nothing\n")))
