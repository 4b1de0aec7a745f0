"""The cache of remote logs: complete or absent, bounded, and what is in use stays."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from gridslam.errors import InputError
from gridslam.io import cache as module
from gridslam.io.cache import LogCache, find_origin
from gridslam.io.text import compute_digest


@pytest.fixture(autouse=True)
def forget(monkeypatch):
    """Locks of one test are not those of the next."""
    monkeypatch.setattr(module, "_used", {})


def writer(content=b"a log", name="run.clf", calls=None):
    def download(folder):
        if calls is not None:
            calls.append(name)
        (folder / name).write_bytes(content)
        return folder / name

    return download


def release():
    for entry in list(module._used):
        module._release(entry)


def test_a_log_is_downloaded_once_and_again_where_its_state_has_changed(tmp_path):
    cache, calls = LogCache(tmp_path / "cache", 1000), []
    first = cache.get("s3://b/run.clf", "1", writer(calls=calls))
    again = cache.get("s3://b/run.clf", "1", writer(calls=calls))
    other = cache.get("s3://b/run.clf", "2", writer(b"another", calls=calls))
    assert first == again != other
    assert len(calls) == 2
    assert first.sha256 == compute_digest(first.path)
    assert find_origin(other.path) == "s3://b/run.clf"
    assert find_origin(tmp_path / "run.clf") is None


def test_those_without_use_for_the_longest_time_are_removed(tmp_path):
    cache = LogCache(tmp_path, 100)
    for k in range(3):
        cache.get(f"s3://b/{k}.clf", "", writer(b"x" * 30, f"{k}.clf"))
        release()
    cache.get("s3://b/0.clf", "", writer())  # there already, and used now
    release()
    cache.get("s3://b/3.clf", "", writer(b"x" * 30, "3.clf"))
    assert sorted(path.name for path in tmp_path.glob("*/*.clf")) == ["0.clf", "2.clf", "3.clf"]


def test_a_log_that_a_process_uses_stays(tmp_path):
    """A child takes a lock; that this process would remove its log for want of room must not matter to it."""
    code = (
        "import sys; from pathlib import Path; from gridslam.io.cache import LogCache\n"
        "def get(folder):\n    (folder / 'a.clf').write_bytes(b'x' * 60); return folder / 'a.clf'\n"
        "LogCache(Path(sys.argv[1]), 100).get('s3://b/a.clf', '', get); print('here', flush=True); sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"here\n"
        LogCache(tmp_path, 100).get("s3://b/b.clf", "", writer(b"x" * 60, "b.clf"))
        assert sorted(path.name for path in tmp_path.glob("*/*.clf")) == ["a.clf", "b.clf"]
        child.stdin.close()
        child.wait()
    release()
    LogCache(tmp_path, 100).get("s3://b/c.clf", "", writer(b"x" * 30, "c.clf"))
    assert sorted(path.name for path in tmp_path.glob("*/*.clf")) == ["b.clf", "c.clf"]


def test_a_log_larger_than_the_cache_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"s3://b/run\.clf: .* do not fit in the cache"):
        LogCache(tmp_path, 3).get("s3://b/run.clf", "", writer())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["0", "-1", "much", "nan", "inf"])
def test_the_limit_is_a_number_above_zero(monkeypatch, text):
    monkeypatch.setitem(os.environ, "GRIDSLAM_CACHE_GB", text)
    with pytest.raises(InputError, match="GRIDSLAM_CACHE_GB: expected a number of GB above 0"):
        LogCache.default()
