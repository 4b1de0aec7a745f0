"""Classes of parameters: what is taken as it is, what is converted, and what is refused."""

from __future__ import annotations

import copy
import inspect
import math
import pickle
import subprocess
import sys
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace
from functools import cached_property

import pytest
from pydantic import ValidationError

from gridslam.config import Configuration
from gridslam.localization.odometry_check import OdometryCheck
from gridslam.models import BeamRangeFinder
from gridslam.parameters import adapter, parameters, replace_plainly, to_table
from gridslam.particles.policies import MotionThreshold
from gridslam.scan import Thinning


def test_tables_are_those_that_pydantic_would_write_but_for_kinds():
    def without_kinds(table):
        return (
            {name: without_kinds(value) for name, value in table.items() if name != "kind"}
            if isinstance(table, dict)
            else table
        )

    config = Configuration()
    assert without_kinds(to_table(config)) == adapter(Configuration).dump_python(config)
    assert to_table(replace(config, loop_closure=None))["loop_closure"] == {"kind": "none"}


def test_values_are_converted_as_pydantic_converts_them():
    threshold = MotionThreshold(1, rotation_rad="0.5")
    assert threshold == MotionThreshold(1.0, 0.5)
    assert [type(value) for value in vars(threshold).values()] == [float, float]
    assert MotionThreshold(math.inf).translation_m == math.inf


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: MotionThreshold(translation_m=0.0), "translation_m"),
        (lambda: MotionThreshold(translation_m=math.nan), "translation_m"),
        (lambda: MotionThreshold(0.5, 0.5, 0.5), "unexpected_positional"),
        (lambda: Thinning(spacing=0.1), "spacing"),
        (lambda: Thinning(dense_beams=10.5), "dense_beams"),
        (lambda: Configuration(particles=True, range_max_m=math.inf), "range_max_m"),
        (lambda: OdometryCheck(gate=math.inf), "gate"),  # which has no upper bound
        (lambda: Configuration(resampler="none"), "resampler"),
        (lambda: BeamRangeFinder(z_hit=0.1), "must sum to 1"),
    ],
)
def test_what_is_wrong_is_named(make, name):
    with pytest.raises(ValidationError, match=name):
        make()


def test_parameters_are_replaced_plainly_where_none_needs_to_be_converted_or_refused():
    config = Configuration()
    changes = {"particles": 7, "tracker": {"insert_m": 0.3, "matcher": {"max_iterations": 9}}, "resampler": "wheel"}
    matcher = replace(config.tracker.matcher, max_iterations=9)
    tracker = replace(config.tracker, insert_m=0.3, matcher=matcher)
    assert replace_plainly(config, changes) == replace(config, particles=7, tracker=tracker, resampler="wheel")
    assert replace_plainly(config, {}) == config
    assert replace_plainly(BeamRangeFinder(), {"z_hit": 0.1}) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"particles": 7.0},
        {"particles": True},
        {"particles": 0},
        {"tracker": {"insert_m": 1}},
        {"tracker": {"insert": 0.3}},
        {"tracker": {"kind": "OdometryTracker"}},
        {"particles": {"insert_m": 0.3}},
        {"loop_closure": False},
        ["particles"],  # as a damaged file may have it
        {1: 2},
        None,
    ],
)
def test_all_else_is_left_to_pydantic(changes):
    assert replace_plainly(Configuration(), changes) is None


def test_right_values_need_no_pydantic():
    code = (
        "import sys; from dataclasses import replace; from gridslam import Configuration, preset; "
        "preset('gmapping', 8); "
        "replace(Configuration(particles=15, range_max_m=20.0, resampler='wheel'), loop_closure=None); "
        "sys.exit('pydantic' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def _declare(decorate):
    @decorate
    class Laser:
        reach_m: float
        name: str = "laser"
        inner: Thinning = Thinning()
        counts: tuple[int, ...] = field(default_factory=lambda: (1, 2))

        @cached_property
        def doubled_m(self):
            return 2 * self.reach_m

    return Laser


_Plain = _declare(dataclass(frozen=True))
_Checked = _declare(parameters(frozen=True))


def test_classes_of_parameters_behave_as_frozen_dataclasses():
    plain, checked = (kind(2.0, inner=Thinning(dense_beams=7)) for kind in (_Plain, _Checked))
    assert repr(checked) == repr(plain)
    assert hash(checked) == hash(plain)
    assert checked == _Checked(2.0, "laser", Thinning(dense_beams=7), (1, 2)) != _Checked(3.0)
    assert checked != plain
    assert checked.doubled_m == 4.0  # which does not count as a field
    assert checked == replace(_Checked(5.0, inner=Thinning(dense_beams=7)), reach_m=2.0)
    signatures = [list(inspect.signature(kind).parameters.values()) for kind in (_Checked, _Plain)]
    assert signatures[0][:3] == signatures[1][:3]
    assert str(signatures[0][3]) == "counts: 'tuple[int, ...]' = (1, 2)"  # `dataclass` names no default of a factory
    assert [each.name for each in fields(_Checked)] == [each.name for each in fields(_Plain)]
    assert _Checked.__match_args__ == _Plain.__match_args__


def test_parameters_cannot_be_changed_and_can_be_copied():
    threshold = MotionThreshold(0.4, 0.3)
    with pytest.raises(FrozenInstanceError, match="translation_m"):
        threshold.translation_m = 1.0
    with pytest.raises(FrozenInstanceError, match="rotation_rad"):
        del threshold.rotation_rad
    assert pickle.loads(pickle.dumps(threshold)) == copy.deepcopy(threshold) == threshold
    assert list(inspect.signature(MotionThreshold).parameters) == ["translation_m", "rotation_rad"]


@pytest.mark.parametrize("arguments", [((), {}), ((1.0, "a", "b", (1,), 5), {}), ((1.0,), {"reach_m": 1.0})])
def test_arguments_that_are_not_those_of_the_class_are_refused(arguments):
    args, kwargs = arguments
    with pytest.raises(ValidationError):
        _Checked(*args, **kwargs)
