"""The simulation of a large batch: bounds that hold for any, and the table of the docs."""

from __future__ import annotations

import json

import numpy as np
import pytest

from measure import RESULTS
from scale import BUILT, SCENARIOS, Parts, main, make_durations, simulate

DURATIONS = make_durations(2000, np.random.default_rng(1))


@pytest.mark.parametrize("parts", SCENARIOS.values(), ids=SCENARIOS)
def test_no_batch_is_faster_than_its_workers(parts):
    outcome = simulate(DURATIONS, 40, parts)
    assert outcome.wall_s >= outcome.ideal_s
    assert all(0 <= share <= 1 + 1e-9 for share in outcome.busy.values())


def test_without_costs_of_its_own_a_batch_takes_what_the_longest_first_rule_guarantees():
    """At most 4/3 of the optimum (Graham 1969), which is at least the ideal."""
    free = Parts(submit_s=0.0, commit_s=0.0, row_s=0.0, message_s=0.0, request_s=0.0, download_s=0.0, child_s=0.0)
    outcome = simulate(DURATIONS, 40, free)
    assert outcome.ideal_s <= outcome.wall_s <= 4 / 3 * outcome.ideal_s
    assert simulate(DURATIONS, 80, free).wall_s <= outcome.wall_s


def test_the_part_that_limits_is_the_one_that_was_made_slow():
    assert simulate(DURATIONS, 40, Parts(message_s=1.0)).bottleneck == "scheduler"
    assert simulate(DURATIONS, 40, Parts(row_s=1.0)).bottleneck == "client"
    assert simulate(DURATIONS, 40, BUILT).bottleneck == "workers"
    slow = simulate(DURATIONS, 40, Parts(message_s=1.0))
    assert slow.wall_s == pytest.approx(len(DURATIONS) * 1.0, rel=0.1)


def test_small_logs_and_large_ones_are_made_longest_first():
    assert (np.diff(DURATIONS) <= 0).all()
    assert 3 < DURATIONS.mean() < 15


def test_the_docs_have_the_table_of_the_committed_simulation():
    committed = json.loads((RESULTS / "scale.json").read_text(encoding="utf-8"))
    assert "1000000 logs" in committed["how"]
    assert "10000 workers" in committed["how"]
    page = (RESULTS.parents[1] / "docs" / "batch.md").read_text(encoding="utf-8")
    shown = page.partition("<!-- scale -->\n")[2].partition("<!-- end of scale -->")[0]
    assert shown.splitlines() == committed["table"]


def test_the_program_writes_its_table(tmp_path):
    path = main(["--logs", "300", "--workers", "10", "-o", str(tmp_path / "scale.json")])
    assert len(json.loads(path.read_text())["scenarios"]) == len(SCENARIOS)
