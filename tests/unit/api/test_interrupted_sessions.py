"""A run that goes on from earlier drives, killed before, while and after it is found: the same to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.api.autosave import Autosave
from gridslam.errors import InputError
from gridslam.io.maps import read_map, write_map
from support.interrupted import (
    CARRIED_AFTER,
    CARRIED_SCANS,
    SCANS,
    SCENARIOS,
    make_building,
    resume_after,
    run_node,
    run_whole,
)


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_an_interrupted_run_is_found_again_and_gives_the_same_bytes(building, tmp_path, scenario):
    whole, found = run_whole(scenario, building, tmp_path / "whole")
    begins = (CARRIED_AFTER - 1, CARRIED_AFTER, CARRIED_AFTER + 1) if "carried" in scenario else ()
    last = CARRIED_SCANS if begins else SCANS
    assert 5 < found < last - 20
    for scan in (*begins, found - 1, found, found + 1, found + 2, (found + last) // 2, last):
        again = resume_after(scan, scenario, building, tmp_path / str(scan))
        assert again.keys() == whole.keys()
        assert [name for name in whole if again[name] != whole[name]] == [], scan


def test_a_node_that_goes_on_from_what_another_one_has_left_gives_the_same_bytes(building, tmp_path):
    """`serialize_map` and the autosave, before and after it was found: with another building as a piece apart."""
    whole = run_node(building, tmp_path / "whole")
    assert whole["found"]["drives"] == ("monday",)
    assert whole["apart"] == [["annex"]]
    for number, cuts in enumerate(([30], [150], [30, 90, 200])):
        for autosaved in (False, True):
            again = run_node(building, tmp_path / f"{number}{autosaved}", cuts, autosaved=autosaved)
            assert again.keys() == whole.keys()
            assert [name for name in whole if again[name] != whole[name]] == [], cuts


def test_what_was_begun_in_one_map_does_not_go_on_in_another(building, tmp_path):
    """The same log and seed; of the given map alone the walls have changed."""
    (tmp_path / "other").mkdir()
    for name in ("known.yaml", "known.pgm", "tuesday.csv"):
        (tmp_path / "other" / name).write_bytes((building / name).read_bytes())
    resume_after(40, "prior", building, tmp_path / "out")
    grid = read_map(tmp_path / "other" / "known.yaml")
    rows, columns = np.nonzero(grid.log_odds > 1)
    grid.log_odds[rows[::20], columns[::20]] = 0.0
    write_map(tmp_path / "other" / "known.yaml", grid)
    autosave = Autosave(tmp_path / "out" / "autosave.gridslam", 3600.0)
    with pytest.raises(InputError, match="that of another run"):
        run_whole("prior", tmp_path / "other", tmp_path / "no", autosave=autosave)
