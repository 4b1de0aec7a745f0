"""The benchmark of the live node runs, on a second of a drive."""

from __future__ import annotations

import numpy as np
import pytest

import node
from load import LATENCY, drive
from report import Report


def test_a_drive_goes_on_for_as_long_as_is_asked():
    messages = list(drive(200.0, 0.5, 12))  # longer than once through the office
    assert len(messages) == 100
    assert [scan.stamp_ns for _, scan in messages[:3]] == [0, 2 * 10**9, 4 * 10**9]
    assert all(odometry.stamp_ns == scan.stamp_ns for odometry, scan in messages)


def test_the_node_under_load():
    load = node.load_on_core(0.5, 40.0, 60, 3)
    assert (load.sent, load.dropped, load.refused) == (20, 0, 0)
    latency, step = load.parts_s[LATENCY], load.parts_s["of it the step"]
    assert len(latency) == 20
    assert (latency > step).all()
    assert (step > 0).all()
    assert load.cpu_s >= load.parts_s["CPU of the filter's thread"].sum()
    report = Report()
    node.tell(report, "usual", load, 40.0)
    node.tell(report, "ten times", load, 400.0)
    assert "20 scans sent, 20 mapped, 0 dropped, 0 refused" in report.sections[0]
    assert [target.name.split(": ")[0] for target in report.targets] == ["usual"] * 4 + ["ten times"] * 2
    assert report.targets[1].value == pytest.approx(1e3 * np.percentile(latency, 99))


def test_a_grid_s_bytes_are_published():
    from node_dds import grid_ms

    assert all(milliseconds > 0 for _, milliseconds in grid_ms(2))
