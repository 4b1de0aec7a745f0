"""A node that continues earlier drives, ended before and after it is found: the same to the last bit."""

import pytest

from support.interrupted import make_building, run_node


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


def test_a_node_that_goes_on_from_what_another_one_has_left_gives_the_same_bytes(building, tmp_path):
    """A saved session and the autosave, before and after it was found: with another building as a piece apart."""
    whole = run_node(building, tmp_path / "whole")
    assert whole["found"]["drives"] == ("monday",)
    assert whole["apart"] == [["annex"]]
    for autosaved in (False, True):
        again = run_node(building, tmp_path / str(autosaved), [30, 90, 200], autosaved=autosaved)
        assert again.keys() == whole.keys()
        assert [name for name in whole if again[name] != whole[name]] == []
