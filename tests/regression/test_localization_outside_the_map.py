"""Global localization in buildings of which half is mapped."""

from functools import cache

import half_mapped as benchmark
from half_mapped import SCANS, localize_from

half_mapped = cache(benchmark.half_mapped)


def test_a_robot_outside_what_is_mapped_is_not_found_somewhere_in_it():
    """Where a fix does not ask for the outside, 76 scans of this drive are localized in wrong places."""
    known, drive = half_mapped("random", 13)
    counts = localize_from(known, drive, len(drive.measurements) // 4, 13)
    assert counts["found_inside"] + counts["found_outside"] > SCANS // 10
    assert counts["wrong"] <= 10, "a place that looks like another one may be told for two seconds"


def test_a_robot_that_leaves_the_map_is_found_where_it_comes_back():
    """It was looked for in the whole map there, found in an equal room at 84 scans, and half as often where it was."""
    known, drive = half_mapped("rooms", 2)
    counts = localize_from(known, drive, 33, 33)
    assert counts["wrong"] == 0
    assert counts["found_inside"] > 0.8 * counts["inside"]


def test_where_places_look_alike_for_longer_a_place_is_found_later():
    """Outside, this robot was found twice, after 14 m and after 15.6 m, in a mapped corridor like the one it was in."""
    known, drive = half_mapped("random", 13)
    counts = localize_from(known, drive, 597, 597)
    assert counts["wrong"] == 0
    assert counts["found_inside"] > 100
