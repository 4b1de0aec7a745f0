"""slam_gmapping's parameters by their own names."""

import pytest

from gridslam.config.tables import value_of
from gridslam.errors import ConfigurationError
from gridslam.ros.node.parameters import (
    _DERIVED,
    _FILTER,
    _NODE,
    _UNSUPPORTED,
    GMAPPING_DEFAULTS,
    NODE_DEFAULTS,
    node_parameters,
)

LISTED = """
throttle_scans base_frame map_frame odom_frame map_update_interval maxUrange sigma kernelSize lstep astep iterations
lsigma ogain lskip minimumScore srr srt str stt linearUpdate angularUpdate temporalUpdate resampleThreshold particles
xmin ymin xmax ymax delta llsamplerange llsamplestep lasamplerange lasamplestep transform_publish_period occ_thresh
maxRange tf_delay
""".split()  # noqa: SIM905


def test_every_documented_parameter_is_known():
    assert set(GMAPPING_DEFAULTS) == set(LISTED)


def test_every_parameter_does_something_or_says_why_not():
    for name in GMAPPING_DEFAULTS:
        assert sum(name in table for table in (_FILTER, _DERIVED, _NODE, _UNSUPPORTED)) == 1, name
    others = {"preset", "config", "set", "record", "out", "save", "continue", "autosave", "map_file", "tf_broadcast"}
    assert {*_NODE, *others} >= set(NODE_DEFAULTS)


@pytest.mark.parametrize(
    ("given", "path", "value"),
    [
        ({"particles": 80}, "particles", 80),
        ({"particles": 80}, "sensor.likelihood_gain", 240.0),
        ({"ogain": 2, "particles": 10}, "sensor.likelihood_gain", 20.0),
        ({"kernelSize": 2, "delta": 0.1}, "sensor.kernel_m", 0.25),
        ({"kernelSize": 2, "delta": 0.1}, "proposal.matcher.kernel_m", 0.25),
        ({"delta": 0.1}, "mapper.resolution_m", 0.1),
        ({"maxUrange": 16}, "range_max_m", 16.0),
        ({"maxRange": 20.0}, "range_max_m", 20.0),
        ({"maxRange": 20.0, "maxUrange": 16.0}, "range_max_m", 16.0),
        ({"maxUrange": 100.0}, "range_max_m", 100.0),
        ({"sigma": 0.1}, "proposal.matcher.scale_m2", 0.1),
        ({"lsigma": 0.1}, "sensor.scale_m2", 0.1),
        ({"lskip": 3}, "sensor.skip", 3),
        ({"lstep": 0.02}, "proposal.matcher.step_m", 0.02),
        ({"astep": 0.02}, "proposal.matcher.step_rad", 0.02),
        ({"iterations": 7}, "proposal.matcher.halvings", 7),
        ({"minimumScore": 50}, "proposal.matcher.minimum_score", 50),
        ({"srr": 0.01}, "motion.srr", 0.01),
        ({"srt": 0.02}, "motion.srt", 0.02),
        ({"str": 0.03}, "motion.str", 0.03),
        ({"stt": 0.04}, "motion.stt", 0.04),
        ({"linearUpdate": 0.3}, "when_to_update.translation_m", 0.3),
        ({"angularUpdate": 0.3}, "when_to_update.rotation_rad", 0.3),
        ({"resampleThreshold": 0.8}, "when_to_resample.fraction", 0.8),
        ({"preset": "default"}, "range_max_m", 30.0),
        ({"preset": "default", "maxUrange": 16.0}, "range_max_m", 16.0),
        ({"preset": "default", "particles": 50}, "particles", 50),
        ({"preset": "default", "linearUpdate": 0.3}, "when_to_update.translation_m", 0.3),
        ({"preset": "default", "set": "tempering=0.1; loop_closure=false"}, "sensor.tempering", 0.1),
        ({"preset": "default", "set": "tempering=0.1; loop_closure=false"}, "loop_closure", False),
    ],
)
def test_what_a_parameter_comes_to(given, path, value):
    parameters = node_parameters(given)
    assert value_of(parameters.configuration, path) == pytest.approx(value)
    assert parameters.warning == ""


@pytest.mark.parametrize(
    ("given", "field", "value"),
    [
        ({"tf_delay": 0.2}, "tf_delay_s", 0.2),
        ({"transform_publish_period": 0.1}, "tf_delay_s", 0.1),
        ({"transform_publish_period": 0}, "transform_publish_period_s", 0.0),
        ({"map_update_interval": 1}, "map_update_interval_s", 1.0),
        ({"throttle_scans": 2}, "throttle_scans", 2),
        ({"base_frame": "base_footprint"}, "base_frame", "base_footprint"),
        ({"odometry": "optional"}, "odometry", "optional"),
    ],
)
def test_what_a_parameter_of_the_node_comes_to(given, field, value):
    assert getattr(node_parameters(given).settings, field) == value


def test_all_that_is_ignored_is_named_in_one_sentence():
    given = {"xmin": -50.0, "ymax": 50.0, "occ_thresh": 0.3, "srr": 0.1, "particels": 5, "delta": 0.1}
    warning = node_parameters(given, "default").warning
    assert warning.count("ignored parameters") == 1
    assert "xmin, ymax (the map grows by itself)" in warning
    assert "occ_thresh (cells are occupied above" in warning
    assert "srr (the preset default has no such part)" in warning
    assert "particels (there is no such parameter; did you mean particles?)" in warning
    assert "delta" not in warning


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"particles": "many"}, "particles: expected a"),
        ({"particles": -1}, "particles: expected a number greater than or equal to 1"),
        ({"delta": 0}, "delta: expected a number greater than or equal to 0.01"),
        ({"ogain": "much"}, "ogain: expected a number, got 'much'"),
        ({"map_update_interval": -1}, "map_update_interval: expected a number greater than or equal to 0, got -1"),
        ({"linearUpdate": -1.0}, "^linearUpdate: expected a number greater than or equal to 0.000000000001, got -1.0"),
        ({"maxUrange": 0}, "^maxUrange and maxRange: expected a number greater than or equal to 0.000001"),
        ({"particles": 40.5}, "^particles: expected a valid integer"),
        ({"base_frame": "/"}, "^base_frame: .*expected the name of a frame"),
        ({"preset": "best"}, "preset: expected"),
    ],
)
def test_wrong_values_are_named(given, says):
    with pytest.raises(ConfigurationError, match=says):
        node_parameters(given)
