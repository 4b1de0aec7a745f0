"""Two thousand damaged logs of every format, other ones than the quick tests see."""

from __future__ import annotations

from support.broken_runs import read_broken_logs, run_broken_logs


def test_two_thousand_broken_logs(tmp_path, record_property):
    came = run_broken_logs(tmp_path, 2000, seed=1, whole_command_every=11)
    record_property("came of it", ", ".join(f"{what}: {count}" for what, count in came.items()))
    assert came.keys() == {"map", "error"}
    assert min(came.values()) > 400


def test_two_thousand_broken_logs_are_diagnosed_and_converted(tmp_path, record_property):
    came = read_broken_logs(tmp_path, 2000, seed=2)
    record_property("came of it", ", ".join(f"{what}: {count}" for what, count in came.items()))
    assert came.keys() == {"diagnosis", "error"}
    assert min(came.values()) > 400
