"""What a robot sees after its laser was blind is joined with what it saw before, at the right place."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import Configuration
from recognition_drives import driven_m, simulated
from recognition_scores import judge, mapped, off_m, rmse

CONFIG = replace(Configuration(), particles=10)


def scored(drive, arcs):
    """Number of recognized arcs, of right and of false constraints, and the answer's rms error in m."""
    said = mapped([drive.everything[k] for k in drive.lit.tolist()], CONFIG)
    truth, driven = drive.truth[drive.lit], driven_m(drive.truth)[drive.lit]
    recognized, right, false, _ = judge(truth, driven, said, np.array(arcs))
    return recognized, right, false, rmse(off_m(truth, said.full))


@pytest.mark.parametrize(
    ("kind", "seed", "arcs", "most_m"),
    [
        ("rooms", 3, [(30.3, 42.2), (52.3, 60.4)], 0.02),  # places that the robot knew of while it drove stay known
        ("demo", 2, [(72.1, 82.5), (91.4, 114.4)], 0.05),  # what short components share is less than a room
        (
            "loop",
            3,
            [(95.3, 97.7), (100.1, 103.7)],
            0.05,
        ),  # a gap within a submap, which makes a place beyond uncertain
        ("random", 2, [(89.6, 97.5), (105.3, 116.7)], 1.5),  # a place that looks alike, turned by 90 degrees
    ],
)
def test_certain_revisits_are_recognized(kind, seed, arcs, most_m):
    recognized, right, false, off = scored(simulated(kind, seed), arcs)
    assert recognized == 2
    assert right > 20
    assert false == 0
    assert off < most_m


def test_furniture_that_was_moved_joins_nothing():
    """By 0.6 to 0.9 m, so that scans of hardly anything else fit it where it stands: 34 false constraints before."""
    recognized, right, false, off = scored(
        simulated("moved_furniture", 4), [(73.4, 91.6), (94.0, 109.5), (116.4, 131.9)]
    )
    assert recognized >= 1
    assert right > 50
    assert false == 0
    assert off < 1.5
