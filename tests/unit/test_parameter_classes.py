"""Classes of parameters: what is taken as it is, what is converted, and what is refused."""

from __future__ import annotations

import copy
import inspect
import math
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace
from functools import cached_property

import pytest

from gridslam.config import Configuration
from gridslam.errors import ConfigurationError, GridslamError
from gridslam.localization.odometry_check import OdometryCheck
from gridslam.models import BeamRangeFinder
from gridslam.parameters import parameters
from gridslam.particles.policies import MotionThreshold
from gridslam.scan import Thinning


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
        (lambda: MotionThreshold(0.5, 0.5, 0.5), "unexpected positional"),
        (lambda: Thinning(spacing=0.1), "spacing"),
        (lambda: Thinning(dense_beams=10.5), "dense_beams"),
        (lambda: Configuration(particles=True, range_max_m=math.inf), "range_max_m"),
        (lambda: OdometryCheck(gate=math.inf), "gate"),  # which has no upper bound
        (lambda: Configuration(resampler="none"), "resampler"),
        (lambda: BeamRangeFinder(z_hit=0.1), "must sum to 1"),
    ],
)
def test_what_is_wrong_is_named(make, name):
    with pytest.raises(ConfigurationError, match=name) as raised:
        make()
    assert isinstance(raised.value, GridslamError)
    assert "\n" not in str(raised.value)
    assert "http" not in str(raised.value)


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
    assert [each.name for each in signatures[0]] == [each.name for each in signatures[1]]
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
