"""The benchmark of a small machine limits what it says it limits."""

from __future__ import annotations

import resource

import small_machine


def test_without_control_groups_time_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(small_machine, "_GROUPS", tmp_path / "nowhere")
    with small_machine.limited_to(0.25) as (how, join):
        assert join is None
        assert "not limited" in how


def test_what_is_mapped_inside_has_the_limit_of_memory(monkeypatch):
    code = "import json, os, resource; print(json.dumps([resource.getrlimit(resource.RLIMIT_AS), os.cpu_count()]))"

    def run(command, **options):
        return original([command[0], "-c", code], **options)

    original = small_machine.subprocess.run
    monkeypatch.setattr(small_machine.subprocess, "run", run)
    (limit, hard), _ = small_machine._run_inside(1.0, 300, None)
    assert limit == hard == 300_000_000
    assert resource.getrlimit(resource.RLIMIT_AS)[0] != limit  # this process is as it was
