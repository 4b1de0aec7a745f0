"""What rospy would leave alone without a word is named."""

import pytest

from gridslam.errors import ConfigurationError
from gridslam.ros.ros1.ros1 import check_ros1_arguments


@pytest.mark.parametrize(
    ("argument", "says"),
    [
        ("particles:=80", "a parameter is given as _particles:=80"),
        ("preset:=default", "a parameter is given as _preset:=default"),
        ("--particle", "got '--particle'"),
        ("--particle:=3", "got '--particle:=3'"),
        ("base_scan", "got 'base_scan'"),
        (":=base_scan", "got ':=base_scan'"),
    ],
)
def test_what_would_do_nothing_is_refused(argument, says):
    with pytest.raises(ConfigurationError, match=says):
        check_ros1_arguments(["scan:=base_scan", argument])
