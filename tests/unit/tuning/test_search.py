"""The space that a tuning searches."""

import pytest

from gridslam.config import PARAMETERS, Configuration, preset
from gridslam.errors import ConfigurationError
from gridslam.tuning.search_space import SearchSpace

DEFAULT = Configuration()


def test_all_parameters_with_a_range_are_searched_and_no_others():
    space = SearchSpace.of(DEFAULT)
    assert [one.name for one in space.dimensions] == [name for name, one in PARAMETERS.items() if one.search]
    assert {"particles", "range_min_m", "lost_below"}.isdisjoint(one.name for one in space.dimensions)


@pytest.mark.parametrize("end", ["low", "high"])
def test_ends_are_valid_and_the_default_is_itself(end):
    space = SearchSpace.of(DEFAULT)
    values = space.round({one.name: getattr(one.search, end) for one in space.dimensions})
    assert space.values_of(space.apply(DEFAULT, values)) == values
    assert space.apply(DEFAULT, space.values_of(DEFAULT)) == DEFAULT


def test_parameters_of_another_kind_are_left_out():
    of_gmapping = [one.name for one in SearchSpace.of(preset("gmapping")).dimensions]
    assert "beam_sigma_m" not in of_gmapping
    assert "key_scan_m" in of_gmapping
    with pytest.raises(ConfigurationError, match="beam_sigma_m: cannot be tuned; expected one of resolution_m"):
        SearchSpace.of(preset("gmapping"), ["beam_sigma_m"])
