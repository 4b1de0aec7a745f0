"""What the node does under load in ROS 2, on both transports, from the reports of its tests:

.ci/ros2 jazzy -o junit_family=xunit1 --junitxml=build/loads.xml -m ros2 tests/contracts/ros2/test_load.py
.venv/bin/pytest -o junit_family=xunit1 --junitxml=build/cyclone.xml -m long tests/contracts/test_dds_node.py
.venv/bin/python benchmarks/ros2_loads.py build/*.xml --out benchmarks/results/ros2_loads.json
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from measure import write_document


def read(path: Path) -> dict[str, dict[str, str]]:
    """The figures that each test of a report has recorded."""
    return {
        f"{Path(case.get('file', '')).name}: {case.get('name')}": {
            one.get("name", ""): one.get("value", "") for one in case.iter("property")
        }
        for case in ElementTree.parse(path).iter("testcase")
        if case.find("properties") is not None and case.find("failure") is None
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures of reports, and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    tests = {name: figures for path in given.reports for name, figures in read(path).items()}
    for name, figures in tests.items():
        print(name, figures)
    if given.out is not None:
        write_document(given.out, "see the head of benchmarks/ros2_loads.py", tests=tests)


if __name__ == "__main__":
    main()
