"""Every number of the configuration at its extremes: named refusal, or a run that ends within seconds and 2 GB."""

import math
import random

import pytest

from support.parameter_extremes import cases, numbers, run_cases


def test_every_number_has_a_least_and_a_greatest_value():
    for number in numbers():
        limits = {key.lower().removeprefix("exclusive") for key, _ in number.schema}
        if not number.name.startswith("when_to_update."):  # infinite: a key scan by the other alone
            assert limits >= {"minimum", "maximum"}, number.name


def test_the_extremes_reach_every_part():
    names = {number.name for number in numbers()}
    assert names >= {"particles", "motion.sigma_xy_m", "mapper.resolution_m", "proposal.matcher.halvings"}
    assert names >= {"loop_closure.drift.sigma_m_per_sqrt_m", "tracker.velocity.speed_mps"}
    assert len(cases()) > 10 * len(names)
    assert {str(value) for _, value in cases()} >= {str(math.nan), str(math.inf), "1e-300", "1e+300", "-1"}


@pytest.mark.parametrize("seed", range(2))
def test_some_extremes(seed):
    _, failures = run_cases(random.Random(seed).sample(cases(), 6))
    assert not failures


@pytest.mark.long
@pytest.mark.parametrize("part", range(8))
def test_all_extremes(part, record_property):
    came, failures = run_cases(cases()[part::8])
    record_property("came of it", ", ".join(f"{what}: {count}" for what, count in came.items()))
    assert not failures
    assert came["mapped"] > 50
    assert came["refused"] > 150
