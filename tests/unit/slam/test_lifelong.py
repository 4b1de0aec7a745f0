"""Two rooms whose furniture is moved overnight, for some days: what has gone fades, and no day is lost."""

from __future__ import annotations

import pytest

from gridslam.config import Configuration, override
from gridslam.sim import LidarConfig
from support import lifelong
from support.lifelong import Floor, live


@pytest.fixture(scope="module")
def days():
    """Four days of 40 m, each from another place."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lifelong, "LIDAR", LidarConfig(beams=90, rate_hz=2.5))
        configuration = override(Configuration(), "particles=2")
        yield [row for row, _ in live(4, 3, Floor(3, rooms=(0, 4)), 40.0, configuration)]


def test_each_day_is_found_and_aligned_with_those_before(days):
    assert all(row["found_m"] < 15 for row in days)
    assert all(row["missed_m"] < 0.04 for row in days[1:])


def test_the_map_of_the_last_day_is_that_of_the_last_day(days):
    """Furniture stands where it was put, where it stood is free, and walls stay."""
    last = days[-1]
    assert last["cells"]["gone"] > 20
    assert last["cells"]["stands"] > 100
    assert last["stands"] >= 0.9
    assert last["gone"] >= 0.75  # of some 50 cells, moved last night: a few beams have passed there since
    assert last["walls"] >= 0.95


def test_the_session_forgets_what_newer_drives_have_seen(days):
    assert days[0]["thinned_bytes"] == days[0]["bytes"]
    assert days[-1]["thinned_bytes"] < days[-1]["bytes"]
    assert max(day["thinned_bytes"] for day in days) < 2.5 * days[0]["bytes"]
