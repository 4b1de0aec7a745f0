"""Furniture that was moved between two days is found, in maps of their own; maps that lie wrong have other changes."""

import pytest

from gridslam.config import Configuration
from map_changes import TARGETS, compare, make_days, score, summarize


@pytest.fixture(scope="module")
def days():
    return make_days(21, Configuration(particles=3))  # of which the benchmark has none


def test_moved_furniture_is_found(days):
    buildings, outlines = days
    changes = compare(buildings)
    assert changes.alignment.residual_m < 0.03
    summary = summarize([score(buildings, outlines, changes)])
    assert all(summary[name] >= least for name, least in TARGETS.items())


def test_a_wrong_alignment_is_noticed(days):
    buildings, outlines = days
    summary = summarize([score(buildings, outlines, compare(buildings, "shifted"))])
    assert summary["precision"] < 0.5
