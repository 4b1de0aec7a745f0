"""The benchmark of reading runs, and measures every format."""

from __future__ import annotations

from reading import reading
from report import Report


def test_every_format_is_read():
    report = Report()
    reading(report, scans=40, repeats=1)
    assert [line.split(" | ")[0] for line in report.sections[0].splitlines()[4:]] == [
        "| ROS 1 .bag",
        "| ROS 2 .db3",
        "| ROS 2 .mcap",
    ]
    assert len(report.targets) == 6
    assert all(target.value > 0 for target in report.targets)
