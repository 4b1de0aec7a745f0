"""A landmark sensor with systematic errors: its Jacobians, and what is located is measured so."""

import numpy as np
import pytest

from gridslam.models.landmark import (
    DepthBearing,
    RangeBearing,
    RelativePosition,
    linearize_calibrated,
    locate_calibrated,
)
from gridslam.models.systematic_errors import NO_ERRORS, SystematicErrors

POSE = np.array([1.0, -2.0, 0.7])
CALIBRATION = np.array([-0.05, 0.04])
SENSORS = pytest.mark.parametrize("sensor", [RangeBearing(), DepthBearing(), RelativePosition()])


@SENSORS
def test_the_jacobians_are_finite_differences(sensor):
    landmark = np.array([4.0, 0.5])
    _, *jacobians = linearize_calibrated(sensor, POSE, landmark, CALIBRATION)
    at = [POSE, landmark, CALIBRATION]
    for which, jacobian in enumerate(jacobians):
        for k in range(len(at[which])):
            ends = []
            for step in (1e-6, -1e-6):
                moved = [value.copy() for value in at]
                moved[which][k] += step
                ends.append(linearize_calibrated(sensor, *moved)[0])
            np.testing.assert_allclose(jacobian[:, k], (ends[0] - ends[1]) / 2e-6, atol=1e-7)


@SENSORS
def test_what_is_located_is_measured_so(sensor):
    seen = linearize_calibrated(sensor, POSE, np.array([4.0, 0.5]), CALIBRATION)[0]
    np.testing.assert_allclose(locate_calibrated(sensor, POSE, seen, CALIBRATION), [4.0, 0.5], atol=1e-12)


def test_which_errors_are_of_the_sensor():
    errors = SystematicErrors(sigma_odometry_scale=0.05, sigma_mounting_m=0.05, sigma_range_scale=0.03)
    values = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    assert errors.names == ["turn_per_m", "turn_per_rad", "odometry_scale", "mounting_m", "range_scale"]
    np.testing.assert_array_equal(errors.calibration(values), [0.4, 0.5])
    np.testing.assert_allclose(errors.by_errors(np.array([2.0, 1.0, 0.5])) @ values, [0.6, 0.3, 0.3])
    np.testing.assert_array_equal(NO_ERRORS.calibration(np.empty((4, 0))), np.zeros((4, 2)))
