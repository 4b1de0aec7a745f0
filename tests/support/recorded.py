"""Finished runs with their past, as `gridslam map` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gridslam.api.mapping import MapResult, map_log
from gridslam.live.history_file import HISTORY_NAME, write_history
from gridslam.live.recorder import RunRecorder


def map_with_history(log: Path, out: Path, **given: Any) -> MapResult:
    """Map a log, and write the results and the past to a folder."""
    recorder = RunRecorder()
    result = map_log(log, observers=[recorder], gate=recorder.follow, **given)
    result.save(out)
    write_history(out / HISTORY_NAME, recorder.history)
    return result
