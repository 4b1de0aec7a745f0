"""The benchmark of batches runs, on two logs."""

from __future__ import annotations

import json

import pytest

import batch

pytest.importorskip("resource")


def test_each_way_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "SECONDS", 4)
    assert batch.main(["--logs", "2", "--out", str(tmp_path / "batch.json")]) == 0
    document = json.loads((tmp_path / "batch.json").read_text())
    assert set(document["ways"]) == {"one worker", "two workers", "shell loop"}
    assert all(row["wall_s"] > 0 and row["cpu_s"] > 0 for row in document["ways"].values())
    assert 0 < document["ratios"]["one worker, share outside the children"] < 1
