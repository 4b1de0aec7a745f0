"""On which floor a robot is said to be."""

from pathlib import Path

import pytest

from gridslam.api.floors import choose_floor


@pytest.mark.parametrize(
    ("ground", "upper", "floor", "reason"),
    [
        (0.8, 0.3, "ground", ""),
        (0.2, 0.9, "upper", ""),
        (0.8, 0.5, None, "the maps do not differ enough"),
        (0.29, 0.0, None, "the robot is localized at less than 30% of the scans in each"),
        (0.1, 0.1, None, "the robot is localized at less than 30% of the scans in each"),
    ],
)
def test_the_floor_is_known_where_its_map_fits_clearly_best(ground, upper, floor, reason):
    found = choose_floor({Path("ground"): ground, Path("upper"): upper})
    assert found == (None if floor is None else Path(floor), reason)
