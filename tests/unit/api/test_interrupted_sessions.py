"""A run that goes on from earlier drives or a map, killed before, while and after it is found: the same to the last bit."""

from __future__ import annotations

import pytest

from support.interrupted import SCANS, SCENARIOS, make_building, resume_after, run_whole


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_an_interrupted_run_is_found_again_and_gives_the_same_bytes(building, tmp_path, scenario):
    whole, found = run_whole(scenario, building, tmp_path / "whole")
    assert 5 < found < SCANS - 100
    for scan in (found - 1, found, found + 1, found + 2, found + 90, SCANS):
        again = resume_after(scan, scenario, building, tmp_path / str(scan))
        assert again.keys() == whole.keys()
        assert [name for name in whole if again[name] != whole[name]] == [], scan
