"""A damaged log of any format gives a map or one named error: no other exception, no hang, no half of an output.

So does what diagnoses and converts one. Two thousand of them are in the long tier.
"""

from __future__ import annotations

from support.broken_runs import read_broken_logs, run_broken_logs


def test_sixty_broken_logs(tmp_path):
    came = run_broken_logs(tmp_path, 60, seed=0, whole_command_every=9)
    assert came.keys() == {"map", "error"}
    assert min(came.values()) > 12  # the damage is neither always fatal nor never


def test_thirty_broken_logs_are_diagnosed_and_converted(tmp_path):
    came = read_broken_logs(tmp_path, 30, seed=0)
    assert came.keys() == {"diagnosis", "error"}
    assert min(came.values()) > 6
