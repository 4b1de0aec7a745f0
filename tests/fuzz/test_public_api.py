"""Every public function, class and method with arguments that it does not expect: a sample.

Thousands of calls are in the long tier, and in the table of `tests/fuzz/run.py`.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

from gridslam.errors import ArgumentError, InputError
from gridslam.localization import KnownMap
from gridslam.types import OccupancyGrid
from support.fuzz_api import PACKAGES, PublicCall, api, choose_arguments, make_examples, public_calls, try_call
from support.fuzz_files import Family, run_cases, summarize

forked = pytest.mark.skipif(not hasattr(os, "fork"), reason="cases are called in processes that are forked")


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    return make_examples(tmp_path_factory.mktemp("api"))


def test_all_that_is_public_is_called():
    names = {call.name for call in public_calls()}
    assert len(names) > 300
    assert names >= {
        "gridslam.map_log", "gridslam.KnownMap", "gridslam.KnownMap.is_free", "gridslam.KnownMap.cast_rays",
        "grid.TileMaps.match", "grid.TileMaps.from_arrays", "matching.BranchAndBound.search", "geometry.se2.compose",
        "particles.Systematic.__call__", "models.GaussianIncrement.moments", "transforms.TransformBuffer.lookup",
    }  # fmt: skip
    assert {name.partition(".")[0] for name in names} >= {package.split(".")[-1] for package in PACKAGES[1:4]}


def test_most_calls_have_healthy_arguments(examples):
    """Else each would be refused for the argument that is missing, not for the odd one."""
    whole = 0
    for call in public_calls():
        rng = np.random.default_rng(3)  # the one that makes nothing odd
        _, _, what = choose_arguments(call, examples, rng)
        whole += not any("=" in each for each in what)
    assert whole > 150


@forked
def test_a_sample_of_odd_calls_gives_a_value_or_an_error_of_ours(tmp_path):
    families = [Family(*family) for family in api(tmp_path)]
    (row,) = summarize(run_cases(families, 300, 0, tmp_path), families)
    assert not row["examples"]
    assert min(row["read"], row["refused"]) > 60


@pytest.mark.parametrize(
    "fault",
    [AttributeError("fault"), TypeError("fault"), OverflowError("fault"), IndexError("fault"), ValueError("fault")],
)
def test_a_call_that_fails_is_seen(examples, fault):
    def fail(pose):
        raise fault

    with pytest.raises(RuntimeError, match=type(fault).__name__):
        try_call(PublicCall("fail", "", fail), examples, np.random.default_rng(0))


def test_a_call_that_is_refused_is_seen(examples):
    def refuse(pose):
        raise ArgumentError("pose", "another", pose)

    with pytest.raises(InputError, match="another"):
        try_call(PublicCall("refuse", "", refuse), examples, np.random.default_rng(0))


@pytest.fixture(scope="module")
def known() -> KnownMap:
    log_odds = np.full((60, 60), -4.0, np.float32)
    log_odds[[0, -1]] = log_odds[:, [0, -1]] = 4.0
    return KnownMap(OccupancyGrid(log_odds, np.ones(log_odds.shape, np.bool_), 0.05, (0.0, 0.0)))


@pytest.mark.parametrize("shape", [(10**6, 1), (10**8, 0), (3,), (3, 2), (1, 3, 3)])
def test_poses_of_another_shape_are_refused(known, shape):
    with pytest.raises(ArgumentError, match="poses: expected shape"):
        known.is_free(np.zeros(shape))


@pytest.mark.parametrize("max_m", [1e300, np.inf])
@pytest.mark.parametrize("length", [1.0, 1e10, 1e-10, 1e300, 0.0])
@pytest.mark.parametrize("place", [1.5, 1e6, -5e7, 1e300])
def test_rays_end_where_the_map_does(known, max_m, length, place):
    """From outside, too: as far as a ray is followed nothing is met but the map's walls."""
    found = known.cast_rays(
        np.zeros(2, np.int32), np.array([[1.5, place, 0.3], [place, 1.5, 2.0]]), np.zeros(2), length * np.eye(2), max_m
    )
    assert found.shape == (2, 2)
    if place == 1.5 and length == 1.0:
        assert (found < 3).all()
