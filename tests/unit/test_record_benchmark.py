"""What is recorded for the README."""

import json
import math

import pytest

import scoreboard
from measure import RESULTS
from support.journals import make_rows, write_journal


def run(seed, error_m, **more):
    return {"log": "intel", "variant": "default", "seed": seed, "failed": False, "error_m": error_m, **more}


def test_figures_are_means_over_the_seeds_with_their_interval():
    runs = [run(0, 0.01, cpu_s=3.0), run(1, 0.03, cpu_s=5.0), run(2, None, failed=True)]
    cell = scoreboard.collect(runs)["intel"]["default"]
    assert (cell["seeds"], cell["failed"]) == (3, 1)
    assert (cell["error_m"]["mean"], cell["error_m"]["worst"]) == (0.02, 0.03)
    assert cell["cpu_s"]["high"] - 4.0 == pytest.approx(12.706 * math.sqrt(2) / math.sqrt(2), abs=0.01)  # t of 1 degree


def test_a_scoreboard_is_made_of_a_batch(tmp_path):
    rows = make_rows(4)
    for seed, row in enumerate(rows):
        row["folder"] = f"mit-csail-default-seed{seed}"
    rows[3] |= {"status": "failed", "error": "SIGSEGV", "document": None}
    write_journal(tmp_path / "out", rows)
    path = scoreboard.main([str(tmp_path / "out"), "-o", str(tmp_path / "suite.json")])
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["cells"]["mit-csail"]["default"]["failed"] == 1
    assert [each["failed"] for each in found["runs"]] == [False, False, False, True]


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.name)
def test_every_committed_result_tells_its_source(path):
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["schema"] == "gridslam.benchmark/1"
    if "how" in document:  # measured here
        assert document["commit"]
        assert document["machine"]
    else:
        assert "source" in document or all(figure["source"] and figure["commit"] for figure in document["figures"])
