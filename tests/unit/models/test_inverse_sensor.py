from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ConfigurationError
from gridslam.models import InverseSensorModel


def bayes(prior: float, p_if_occupied: float, p_if_free: float) -> float:
    return p_if_occupied * prior / (p_if_occupied * prior + p_if_free * (1 - prior))


@given(
    true_occupied=st.floats(0.3, 0.95),
    false_occupied=st.floats(0.01, 0.25),
    prior=st.floats(0.05, 0.95),
    measurements=st.lists(st.booleans(), max_size=6),
)
def test_log_odds_are_bayes_rule_on_one_cell(true_occupied, false_occupied, prior, measurements):
    model = InverseSensorModel(true_occupied, 1 - true_occupied, false_occupied, 1 - false_occupied)
    belief, log_odds = prior, math.log(prior / (1 - prior))
    for occupied in measurements:
        if occupied:
            belief = bayes(belief, model.true_occupied, model.false_occupied)
            log_odds += model.log_odds_hit
        else:
            belief = bayes(belief, model.false_free, model.true_free)
            log_odds += model.log_odds_miss
    assert math.isclose(1 / (1 + math.exp(-log_odds)), belief, rel_tol=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"true_occupied": 0.7},
        {"true_free": 0.5},
        {"true_occupied": 0.1, "false_free": 0.9, "false_occupied": 0.2, "true_free": 0.8},
        {"true_occupied": 1.0, "false_free": 0.0},
        {"log_odds_min": 1.0},
        {"log_odds_occupied": 40.0},
        {"log_odds_occupied": -20.0},
        {"log_odds_max": math.inf},
        {"hit": 2.0},
    ],
)
def test_inconsistent_models_are_refused(wrong):
    with pytest.raises(ConfigurationError):
        InverseSensorModel(**wrong)
