"""Configurations: presets, TOML, single parameters, and what each mistake is told."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.config import PARAMETERS, PRESETS, Configuration, build, dumps, load, loads, override, preset
from gridslam.config.tables import names, value_of
from gridslam.errors import ConfigurationError
from gridslam.models import OdometryMotion
from gridslam.parameters import to_table
from gridslam.particles import Residual
from gridslam.slam import GridFastSlam
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.tracking.odometry_calibration import OdometryCalibration


@pytest.mark.parametrize("name", PRESETS)
def test_preset_survives_toml_exactly(name):
    config = preset(name)
    assert loads(dumps(config)) == config
    assert loads(dumps(config), preset("gmapping")) == config  # it says everything, so no base matters


@given(
    st.floats(1e-12, 1e12),
    st.floats(1e-6, 1),
    st.integers(1, 100_000),
    st.sampled_from(["systematic", "stratified", "residual", "multinomial", "wheel"]),
)
def test_every_number_survives_toml_exactly(metres, share, count, resampler):
    changes = f"key_scan_m={metres!r}", f"tempering={share!r}", f"particles={count}", f"resampler={resampler}"
    config = override(Configuration(), *changes)
    assert config.when_to_update.translation_m == metres
    assert config.sensor.tempering == share
    assert (config.particles, config.resampler) == (count, resampler)
    assert loads(dumps(config)) == config


def test_the_default_configuration_builds_the_default_filter_with_loop_closure():
    assert build(Configuration()) == GridFastSlam(loop_closure=LoopClosure())


def test_loop_closure_is_one_field_that_a_word_switches():
    changed = override(Configuration(), "loop_closure.scans_per_step=7")
    assert override(changed, "loop_closure=true") == changed
    off = override(changed, "loop_closure=false")
    assert off.loop_closure is None
    assert off == loads("loop_closure = false", changed) == override(changed, "loop_closure.kind=none")
    assert override(off, "loop_closure=true").loop_closure == LoopClosure()
    again = loads("[loop_closure]\nkind = 'LoopClosure'\nscans_per_step = 7", preset("gmapping"))
    assert again.loop_closure == changed.loop_closure
    with pytest.raises(ConfigurationError, match=r"loop_closure.kind: expected one of LoopClosure, none, got 'None'"):
        override(Configuration(), "loop_closure.kind=None")
    with pytest.raises(ConfigurationError, match="loop_closure: expected a table of parameters, got 'never'"):
        override(Configuration(), "loop_closure=never")


def test_a_part_may_be_none():
    config = override(Configuration(), "tracker.calibration.forgetting_segments=99")
    assert config.tracker.calibration == OdometryCalibration(forgetting_segments=99)
    assert loads(dumps(config)) == config
    without = override(config, "tracker.calibration.kind=none")
    assert without.tracker.calibration is None
    assert to_table(without)["tracker"]["calibration"] == {"kind": "none"}
    assert loads(dumps(without), config) == without
    with pytest.raises(ConfigurationError, match=r"tracker.calibration.forgetting_segments: no such parameter"):
        override(without, "tracker.calibration.forgetting_segments=2")


def test_parameters_of_earlier_versions_are_left_out_where_asked_for():
    """As in sessions that were saved when there were more; of a wrong type or out of range nothing is taken."""
    text = dumps(override(Configuration(), "particles=7", "key_scan_m=0.3"))
    text += "[loop_closure.solver.robust]\nkind = 'Cauchy'\n[final_refinement]\nmax_rounds = 2\n"
    expected = override(Configuration(), "particles=7", "key_scan_m=0.3")
    assert loads(text, ignore_unknown=True) == expected
    with pytest.raises(ConfigurationError, match="no such parameter"):
        loads(text)
    with pytest.raises(ConfigurationError, match=r"tracker.insert_m: expected a number"):
        loads("old = 1\n[tracker]\ninsert_m = -1", ignore_unknown=True)


def test_at_most_eighty_values_can_be_set():
    assert len(list(names(Configuration()))) <= 80  # kinds of parts among them


def test_build_passes_every_part_on():
    config = override(preset("gmapping"), "range_min_m=0.2", "resampler=residual", "lost_below=0.3")
    slam = build(config, threads=3)
    policies = "when_to_update", "when_to_resample"
    for part in ("tracker", "motion", "sensor", "proposal", "mapper", *policies, "reports"):
        assert getattr(slam, part) == getattr(config, part)
    assert (slam.range_min_m, slam.range_max_m, slam.threads) == (0.2, 80.0, 3)
    assert slam.resampler == Residual()


def test_at_most_fifteen_parameters_face_the_user_and_each_is_one():
    assert len(PARAMETERS) <= 15
    known = list(names(Configuration()))
    for parameter in PARAMETERS.values():
        assert parameter.path in known or f"{parameter.path}.kind" in known


@pytest.mark.parametrize("name", PARAMETERS)
def test_short_name_means_the_dotted_one(name):
    path = PARAMETERS[name].path
    value = {"loop_closure": False, "particles": 7}.get(name, 0.125)
    config = override(Configuration(), f"{name}={str(value).lower()}")
    assert value_of(config, path) == value
    assert config == override(Configuration(), f"{path} = {str(value).lower()}")


def test_change_of_kind_starts_from_that_kinds_defaults_whatever_the_order():
    config = override(Configuration(), "motion.alpha1=0.5", "motion.kind=OdometryMotion")
    assert config.motion == OdometryMotion(alpha1=0.5)
    assert override(config, "motion.kind=OdometryMotion") == config


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("tracker.insert_m=-1", "tracker.insert_m: expected a number greater than or equal to 0.000001, got -1"),
        ("insert_m=-1", "tracker.insert_m: expected a number greater than or equal to 0.000001, got -1"),
        ("insert_m=far", "tracker.insert_m: expected a valid number, got 'far'"),
        ("insert_m='0.3'", "tracker.insert_m: expected a valid number, got '0.3'"),
        ("insert_m=inf", "tracker.insert_m: expected a valid number, got inf"),
        ("insert_m=nan", "tracker.insert_m: expected a valid number, got nan"),
        ("insert_m=true", "tracker.insert_m: expected a valid number, got True"),
        ("lost_below=2", "reports.lost_below: expected a number less than or equal to 1, got 2"),
        ("particles=1.5", "particles: expected a valid integer, got 1.5"),
        ("particles=0", "particles: expected a number greater than or equal to 1, got 0"),
        ("particles.x=1", "particles: expected a valid integer, got {'x': 1}"),
        (
            "resampler=wheal",
            "resampler: expected 'systematic', 'stratified', 'residual', 'multinomial' or 'wheel', got 'wheal'",
        ),
        ("resampler=3", "resampler: expected 'systematic', 'stratified', 'residual', 'multinomial' or 'wheel', got 3"),
        ("motion=3", "motion: expected a table of parameters, got 3"),
        ("tracker.insrt_m=1", "tracker.insrt_m: no such parameter; did you mean tracker.insert_m"),
        ("slip_m=1", "slip_m: no such parameter; did you mean tracker.slip_m?"),
        ("particels=1", "particels: no such parameter; did you mean particles or particles_min?"),
        ("nothing.like.it=1", "nothing: no such parameter"),
        ("tracker.matcher.kind=GaussNewton", "tracker.matcher.kind: no such parameter"),
        (
            "motion.kind=Odometrymotion",
            "motion.kind: expected one of DiffusionMotion, OdometryMotion, GMappingMotion, got 'Odometrymotion'; "
            "did you mean OdometryMotion",
        ),
        ("mapper.inverse_sensor.true_free=0.9", "mapper.inverse_sensor: false_occupied and true_free must sum to 1"),
        ("particles", "expected name=value, got 'particles'"),
        ("=3", "expected name=value, got '=3'"),
        ("particles=", "expected name=value, got 'particles='"),
    ],
)
def test_mistake_is_told_in_one_clear_line(assignment, message):
    with pytest.raises(ConfigurationError) as caught:
        override(Configuration(), assignment)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_assignments_that_contradict_each_other_in_form():
    with pytest.raises(ConfigurationError, match=r"tracker.insert_m: tracker was given as 3 before"):
        override(Configuration(), "tracker=3", "tracker.insert_m=0.3")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"particles = ", "expected TOML: "),
        (b"particles = 0", "particles: expected a number greater"),
        (b"[traker]\ninsert_m = 1", "traker: no such parameter; did you mean tracker"),
        (b"\xff\xfe\x00", "expected a text file, got binary data"),
        (b"a = " + b"[" * 9000, "expected TOML: values nested too deeply"),
        (b"#" * (1 << 20) + b"\n", "expected TOML of at most 1048576 characters, got more"),
        (None, "cannot be read: No such file or directory"),
    ],
)
def test_bad_file_is_named(tmp_path, content, message):
    path = tmp_path / "my.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_table_holds_every_parameter_by_name():
    table = to_table(preset("gmapping"))
    for name in names(preset("gmapping")):
        value = table
        for key in name.split("."):
            value = value[key]
        assert not isinstance(value, dict)
