"""gridslam dataset: what is got is what it should be, or nothing is left; from a mirror of our own."""

import hashlib
import json
import socket
import threading
from dataclasses import replace
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from gridslam.errors import ArgumentError
from gridslam.io import datasets
from gridslam.io.datasets import DATASETS, fetch_dataset
from support.refusals import refused

CONTENT = b"FLASER 1 1.0 0 0 0 0 0 0 1.0 host 1.0\n" * 1000


class Handler(BaseHTTPRequestHandler):
    """Serves intel.clf.bz2 as it should be, aces.clf.bz2 as another file, and half of mit-csail.clf.bz2."""

    def do_GET(self):
        self.server.asked.append(self.path)
        content = {"/logs/intel.clf.bz2": CONTENT, "/logs/aces.clf.bz2": b"another", "/logs/mit-csail.clf.bz2": CONTENT}
        if self.path not in content:
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(content[self.path])))
        self.end_headers()
        half = len(CONTENT) // 2 if "mit-csail" in self.path else None
        self.wfile.write(content[self.path][:half])

    def log_message(self, *_):
        pass


@pytest.fixture
def mirror(monkeypatch):
    known = {"sha256": hashlib.sha256(CONTENT).hexdigest(), "size": len(CONTENT)}
    monkeypatch.setattr(datasets, "DATASETS", tuple(replace(dataset, **known) for dataset in DATASETS))
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        running.asked = []
        running.url = f"http://127.0.0.1:{running.server_port}/logs"
        monkeypatch.setenv("GRIDSLAM_DATASETS_URL", running.url)
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def call(call):
    return partial(call, "dataset")


def test_what_is_got_is_checked_and_credited(mirror, tmp_path, call):
    out = tmp_path / "new" / "logs"
    status, told, err = call("get", "intel", "-o", out)
    assert (status, err) == (0, "")
    assert (out / "intel.clf.bz2").read_bytes() == CONTENT
    assert [path.name for path in out.iterdir()] == ["intel.clf.bz2"]
    assert told.startswith(f"{out / 'intel.clf.bz2'}: Intel Research Lab")
    assert "credit: D. Haehnel; the Freiburg SLAM benchmark" in told
    assert "licence: CC BY 3.0" in told
    assert mirror.asked == ["/logs/intel.clf.bz2"]


def test_what_is_there_is_not_got_again(mirror, tmp_path, call):
    for _ in range(2):
        assert call("get", "intel", "-o", tmp_path)[0] == 0
    assert len(mirror.asked) == 1
    (tmp_path / "intel.clf.bz2").write_bytes(b"damaged")
    status, out, _ = call("get", "intel", "-o", tmp_path, "--json")
    assert status == 0
    assert json.loads(out)["path"] == str(tmp_path / "intel.clf.bz2")
    assert json.loads(out)["datasets"][0]["licence"].startswith("CC BY 3.0")
    assert (tmp_path / "intel.clf.bz2").read_bytes() == CONTENT
    assert len(mirror.asked) == 2


@pytest.mark.parametrize("name", ["aces", "mit-csail"])
def test_another_file_or_half_of_it_leaves_nothing(mirror, tmp_path, call, name):
    (tmp_path / f"{name}.clf.bz2").write_bytes(b"of old")
    err = refused(call, tmp_path, "get", name, "-o", tmp_path, status=1)
    assert f"{mirror.url}/{name}.clf.bz2: " in err
    assert (tmp_path / f"{name}.clf.bz2").read_bytes() == b"of old"
    refused(call, tmp_path, "get", name, "-o", tmp_path / "new", status=1)


def test_no_connection(tmp_path, call):
    with socket.socket() as free:  # bound and not listening: nobody answers there
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
        err = refused(call, tmp_path, "get", "intel", "-o", tmp_path / "new", "--url", url, status=1)
    assert f"{url}/intel.clf.bz2: cannot be got: " in err
    assert "refused" in err


def test_a_name_that_is_unknown_lists_the_names(tmp_path, call):
    err = refused(call, tmp_path, "get", "itel", "-o", tmp_path, status=2)
    assert err == "gridslam: NAME: expected intel, aces, mit-csail, got 'itel'; did you mean intel?\n"
    with pytest.raises(ArgumentError, match="name: expected intel, aces, mit-csail, got 'x'"):
        fetch_dataset("x", tmp_path)
