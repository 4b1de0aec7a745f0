"""gridslam regress: two journals beside each other."""

import json

import numpy as np
import pytest

from gridslam.batch.regress import compare_batches
from gridslam.cli.main import main
from gridslam.errors import InputError
from support.journals import make_document, make_rows, write_journal


def write_suite(out, first_seed=0, errors=1.0, cost=1.0, failing=(), seeds=10):
    """A suite of two logs with the spread of the real ones: errors 1 %, CPU time 5 %."""
    rng = np.random.default_rng(first_seed)
    rows = []
    for log in ("intel", "aces"):
        for seed in range(first_seed, first_seed + seeds):
            folder = f"{log}-default-seed{seed}"
            factor = errors if log == "aces" else 1.0
            document = make_document(rng, seed, 0.03 * factor * float(np.exp(rng.normal(0, 0.01))))
            row = make_rows(1)[0] | {"key": folder, "log": f"/data/{log}.clf", "folder": folder}
            row["cpu_s"] = 10 * cost * float(np.exp(rng.normal(0, 0.05)))
            row["peak_memory_bytes"] = round(1e8 * float(np.exp(rng.normal(0, 0.05))))
            if seed in failing:
                row |= {"status": "failed", "error": "SIGSEGV", "document": None}
            else:
                row["document"] = json.dumps(document)
            rows.append(row)
    write_journal(out, rows)
    return out


@pytest.fixture
def old(tmp_path):
    return write_suite(tmp_path / "old")


def test_the_same_run_is_not_worse(old, capsys):
    assert main(["regress", str(old), str(old)]) == 0
    assert capsys.readouterr().out.startswith("nothing is worse beyond noise (20 pairs")


def test_more_error_of_one_log_is_found_and_named(old, tmp_path, capsys):
    new = write_suite(tmp_path / "new", first_seed=100, errors=1.1)
    assert main(["regress", str(old), str(new), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "gridslam.regression/1"
    worse = {(change["log"], change["figure"]) for change in document["worse"]}
    assert {("aces-default", "error_m"), ("aces-default", "error_rad")} <= worse
    assert not any(log.startswith("intel") or figure.startswith(("cpu", "peak")) for log, figure in worse)
    assert main(["regress", str(new), str(old)]) == 0
    assert "better: aces-default: error -9" in capsys.readouterr().out


def test_more_cpu_time_is_found_beyond_its_margin(old, tmp_path):
    new = write_suite(tmp_path / "new", cost=1.3)
    found = compare_batches(old, new)
    assert {change.figure for change in found.worse} == {"cpu_s"}
    assert found.worse[0].mean == pytest.approx(np.log(1.3))  # the seeds are the same, and so their noise
    assert not compare_batches(old, new, cost_margin=0.5).worse


def test_failures_are_found_and_one_alone_is_only_named(old, tmp_path):
    found = compare_batches(old, write_suite(tmp_path / "new", failing=range(8)))
    assert {change.figure for change in found.worse} == {"failed"}
    one = compare_batches(old, write_suite(tmp_path / "one", failing=[4]))
    assert one.worse == []
    assert "fails now: aces-default-seed4, intel-default-seed4" in one.lines()


def test_too_few_runs_are_no_gate_that_cannot_fail(old, tmp_path, capsys):
    new = write_suite(tmp_path / "new", seeds=2)
    assert main(["regress", str(old), str(new)]) == 2
    assert "expected at least 5 runs" in capsys.readouterr().err
    with pytest.raises(InputError, match="expected at least 10 runs"):
        compare_batches(old, write_suite(tmp_path / "four", seeds=4), level=0.001)
