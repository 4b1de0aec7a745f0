"""What a command that refuses its input does: one line, and nothing else."""

from __future__ import annotations


def refused(call, tmp_path, *arguments, status=2) -> str:
    """Check that a command ends with one line on stderr and leaves nothing behind; return the line."""
    before = sorted(tmp_path.rglob("*"))
    got, out, err = call(*arguments)
    assert (got, out) == (status, "")
    assert err.startswith("gridslam: ")
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
    return err
