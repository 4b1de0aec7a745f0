"""Logs at URLs: in a store as fsspec shows it, and on a web server."""

import functools
import http.server
import json
import os
import shutil
import sys
import threading

import pytest

from gridslam.cli.main import main
from gridslam.errors import GridslamError, InputError, MissingDependencyError, OutputError
from gridslam.io import remote
from gridslam.io.log import open_log
from gridslam.io.remote import describe_remote, fetch, find_origin, mask_url

SIGNED = "https://user:pass-word@host:8000/logs/run.clf?X-Amz-Signature=abcdef&X-Amz-Credential=id#part"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.clf"
    assert main(["simulate", "rooms", "-o", str(path), "--duration", "20", "--beams", "60"]) == 0
    return path


@pytest.fixture
def store(tmp_path, monkeypatch):
    """A folder that is read as a store, by URLs of it: what is kept where is the libraries' own."""
    pytest.importorskip("fsspec", reason="fsspec is missing")
    monkeypatch.setenv("GRIDSLAM_CACHE", str(tmp_path / "cache"))
    for below in ("logs", "many"):
        (tmp_path / "fleet" / below).mkdir(parents=True)
    return tmp_path / "fleet"


@pytest.fixture
def web(log, tmp_path, monkeypatch):
    monkeypatch.setenv("GRIDSLAM_CACHE", str(tmp_path / "cache"))

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

    handler = functools.partial(Quiet, directory=str(log.parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize(
    ("url", "masked"),
    [
        (SIGNED, "https://***@host:8000/logs/run.clf?***"),
        ("s3://key:secret@bucket/run.bag", "s3://***@bucket/run.bag"),
        ("s3://bucket/run-?.bag", "s3://bucket/run-?.bag"),
        ("s3://bucket/run.bag?versionId=3", "s3://bucket/run.bag?***"),
        ("/data/user:pass@host/run.bag", "/data/user:pass@host/run.bag"),
    ],
)
def test_credentials_are_masked(url, masked):
    assert mask_url(url) == masked


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingDependencyError, match=r"s3:// needs fsspec.*gridslam\[remote\]"):
        fetch("s3://bucket/run.bag")


@pytest.mark.dev
def test_a_missing_library_for_one_kind_of_url_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(GridslamError, match=r"gs://bucket/run\.bag: cannot be read: .*gcsfs"):
        fetch("gs://bucket/run.bag")
    assert main(["doctor", "nothing-such://host/run.bag"]) == 2


def test_a_log_in_a_store_is_mapped(store, log, tmp_path):
    shutil.copy(log, store / "logs")
    url = (store / "logs" / "run.clf").as_uri()
    out, local = tmp_path / "out", tmp_path / "local"
    assert main(["map", url, "-o", str(out), "--particles", "3"]) == 0
    assert main(["map", str(log), "-o", str(local), "--particles", "3"]) == 0
    assert (out / "trajectory.tum").read_bytes() == (local / "trajectory.tum").read_bytes()
    assert json.loads((out / "run.json").read_text())["input"]["path"] == url


def test_the_store_is_asked_for_a_log_once_and_again_where_it_has_changed(store, log, capsys, monkeypatch):
    downloads = []
    monkeypatch.setattr(remote, "_download", lambda *given, load=remote._download: downloads.append(load(*given)))
    there = store / "logs" / "again.clf"

    def doctor():
        assert main(["doctor", there.as_uri(), "--json"]) == 0
        document = json.loads(capsys.readouterr().out)["log"]
        assert document["path"] == there.as_uri()
        return document["scans"]

    shutil.copy(log, there)
    assert doctor() == doctor() == 101
    assert len(downloads) == 1
    scans = [line for line in log.read_text().splitlines(keepends=True) if line.startswith("FLASER")]
    there.write_text("".join(scans[:51]))
    assert doctor() == 51
    assert len(downloads) == 2


def test_a_bag_that_is_a_folder_is_read_from_the_store(store, log):
    assert main(["convert", str(log), str(store / "bag")]) == 0
    assert len(list(open_log((store / "bag").as_uri()))) == len(list(open_log(log)))


def test_what_is_not_there_is_one_line(store, capsys):
    url = (store / "absent.clf").as_uri()
    assert main(["doctor", url]) == 2
    assert capsys.readouterr().err == f"gridslam: {url}: no such file\n"


def test_a_log_on_a_web_server_is_mapped(web, log, tmp_path, capsys):
    assert main(["map", f"{web}/run.clf?token=abcdefgh", "-o", str(tmp_path / "out"), "--particles", "3"]) == 0
    document = (tmp_path / "out" / "run.json").read_text()
    assert json.loads(document)["input"]["path"] == f"{web}/run.clf?***"
    assert "abcdefgh" not in document + "".join(capsys.readouterr())
    assert describe_remote(f"{web}/run.clf") == describe_remote(f"{web}/run.clf")
    with pytest.raises(InputError, match="no such file"):
        fetch(f"{web}/absent.clf?token=abcdefgh")


def test_a_copy_is_used_until_the_log_changes_and_is_complete_or_absent(web, log, tmp_path, monkeypatch):
    there = log.with_name("changing.clf")
    there.write_bytes(b"one")
    url = f"{web}/changing.clf"
    first = fetch(url)
    assert (first.read_bytes(), find_origin(first), find_origin(there)) == (b"one", url, None)
    first.write_bytes(b"the copy")  # which is not fetched again
    assert fetch(url) == first
    assert first.read_bytes() == b"the copy"
    there.write_bytes(b"another")

    def fail(*paths):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(remote.os, "replace", fail)
        with pytest.raises(OutputError, match="cannot be written: No space left on device"):
            fetch(url)
    assert [*(tmp_path / "cache").rglob("changing.clf")] == [first]
    assert fetch(url).read_bytes() == b"another"


def test_a_copy_that_was_deleted_is_fetched_again(web):
    first = fetch(f"{web}/run.clf")
    content = first.read_bytes()
    first.unlink()
    assert fetch(f"{web}/run.clf") == first
    assert first.read_bytes() == content


def test_a_web_server_shows_by_the_time_that_a_log_of_the_same_size_has_changed(web, log):
    there = log.with_name("as_long.clf")
    for time_s, content in ((1_000_000_000, b"one"), (1_000_000_100, b"two")):
        there.write_bytes(content)
        os.utime(there, (time_s, time_s))
        assert fetch(f"{web}/as_long.clf").read_bytes() == content


def test_a_name_that_leads_out_of_the_folder_of_a_bag_is_refused(tmp_path, monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="fsspec is missing")
    monkeypatch.setenv("GRIDSLAM_CACHE", str(tmp_path / "cache"))
    store = fsspec.filesystem("memory")
    store.pipe({"/fleet/bag/metadata.yaml": b"", "/fleet/bag/../../../../beside": b""})
    with pytest.raises(InputError, match=r"^memory://fleet/bag: expected files below it, got '\.\./.*beside'$"):
        fetch("memory://fleet/bag")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_batch_reads_logs_of_the_store(store, log, tmp_path, call):
    many = store / "many"
    for name in ("a", "b"):
        shutil.copy(log, many / f"{name}.clf")
    (many / "broken.clf").write_text("FLASER 3 1 2\n")
    command = ("batch", f"{many.as_uri()}/", "-o", tmp_path / "out", "--workers", 2)
    options = ("--", "--particles", "3", "--duration", "8")
    status, out, err = call(*command, *options)
    assert status == 1, err
    assert "3 logs: 2 done, 1 failed" in out
    assert f"{many.as_uri()}/broken.clf: InputError" in err
    status, out, _ = call(*command, *options)
    assert "2 done (2 of them before)" in out


def test_a_signed_url_is_in_no_row_and_no_file_of_a_batch(web, tmp_path, call):
    url = f"{web}/run.clf?X-Amz-Signature=abcdefgh"
    status, out, err = call(
        "batch", url, f"{web}/absent.clf?token=abcdefgh", "-o", tmp_path / "out", "--", "--particles", "3"
    )
    assert status == 1
    assert "2 logs: 1 done, 1 failed" in out
    assert (tmp_path / "out" / "run" / "map.png").exists()
    everything = b"".join(path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert b"abcdefgh" not in everything + (out + err).encode()


@pytest.mark.parametrize(("below", "problem"), [("*", "nothing matches this pattern"), ("", "no logs below this URL")])
def test_bad_urls_of_a_batch_are_one_line(store, tmp_path, call, below, problem):
    url = f"{(store / 'logs').as_uri()}/{below}"
    status, _, err = call("batch", url, "-o", tmp_path / "out")
    assert status == 2
    assert err.startswith(f"gridslam: {url}: {problem}")
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
