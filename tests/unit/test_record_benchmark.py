"""What is recorded for the README, and how the code is counted."""

from __future__ import annotations

import json

import pytest

import count
import record
from measure import Cost, MapRun

CODE = '"""A docstring."""\n\nimport math\n\n\ndef f(x):\n    """Another."""\n    if x:  # so\n        return x\n'


def test_statements_are_those_of_the_syntax_tree():
    """An import, a definition, an if and a return; docstrings, comments and blank lines are none."""
    counted = count.count([("a.py", CODE), ("b.cpp", "int x;\n\n"), ("c.html", "<p>\n")])
    assert counted == count.Count(modules=1, statements=4, packed=0, lines=9, compiled_lines=2)


@pytest.mark.parametrize(
    ("code", "statements"),
    [("a, b = 1, c", 2), ("a, b.x, d = c", 1), ("a, b = b, a", 1), ("a = 1, 2", 1), ("a, b, d = c.x, 1, f(2)", 3)],
)
def test_a_packed_assignment_counts_as_what_it_assigns(code, statements):
    counted = count.count([("a.py", code)])
    assert counted.statements == statements
    assert counted.packed == (100.0 if statements > 1 else 0.0)


def test_figures_are_the_mean_and_the_worst_of_the_seeds_and_the_cost_of_the_first():
    first = MapRun(Cost(wall_s=3.0, cpu_s=2.0, yardstick_s=0.25), {"peak_memory_bytes": 3e6}, None)
    found = record.summary({"translation_m": [0.01, 0.03], "rotation_deg": [0.2, 0.2]}, first)
    assert found["seeds"] == 2
    assert found["translation_m"] == {"mean": 0.02, "worst": 0.03}
    assert (found["cpu_s"], found["yardsticks"], found["peak_mb"]) == (2.0, 8.0, 3.0)


def test_ratios_are_told_of_what_both_files_have():
    present = {"intel": {"gridslam": {"translation_m": {"mean": 0.03}, "cpu_s": 5.0, "yardsticks": 20.0}}}
    earlier = {"intel": {"gridslam": {"translation_m": {"mean": 0.02}, "cpu_s": 10.0}}}
    told = record.ratios(present, earlier)["intel"]["gridslam"]
    assert told == {"translation_m": pytest.approx(1.5), "cpu_s": pytest.approx(0.5)}


@pytest.mark.parametrize("path", sorted(record.RESULTS.glob("*.json")), ids=lambda path: path.name)
def test_every_committed_result_tells_its_source(path):
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["schema"] == "gridslam.benchmark/1"
    if "how" in document:  # measured here
        assert document["commit"]
        assert document["machine"]
    else:
        assert "source" in document or all(figure["source"] and figure["commit"] for figure in document["figures"])
