"""--live and view: what they accept, that results are the same, and that others do not pay for them."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import threading

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gridslam.cli.main import main
from gridslam.live.page import LivePage
from support.page_client import PageClient
from support.ports import free_port

SAME = "map.yaml", "map.pgm", "trajectory.tum", "trajectory.csv", "trajectory_online.tum", "graph.g2o"
FEW = "--particles", "4"


@pytest.fixture(scope="module")
def mapped(log, tmp_path_factory):
    out = tmp_path_factory.mktemp("mapped") / "out"
    assert main(["map", str(log), "-o", str(out), *FEW]) == 0
    return out


def look(url, client, out):
    """Look until the page says that all is done, and note whether the results are there then."""
    try:
        with connect(url.replace("http", "ws", 1) + "socket", max_size=None, compression=None) as line:
            while True:
                client.receive(line.recv(20))
                if client.status["stage"] == "finished" and client.run_info["mode"] == "replay":
                    line.send(json.dumps({"do": "seek", "at": 3}))
                if client.status.get("at") == 3:
                    client.written = (out / "run.json").is_file()
                    return
    except ConnectionClosed:
        pass


def test_the_results_are_the_same_with_and_without(call, log, mapped, tmp_path):
    status, _, err = call("map", log, "-o", tmp_path / "out", *FEW, "--live", "--live-port", 0)
    assert status == 0
    assert "live at http://127.0.0.1:" in err
    for name in SAME:
        assert (tmp_path / "out" / name).read_bytes() == (mapped / name).read_bytes(), name


def test_a_viewer_sees_the_run_to_its_end(call, log, tmp_path, monkeypatch):
    client = PageClient()
    status, _, _ = run_viewed(call, monkeypatch, client, "map", log, *FEW, "-o", tmp_path / "out")
    assert status == 0
    assert client.written
    assert client.run_info["mode"] == "replay", "the run is replayed by the page that has seen it"
    assert (client.status["keys"], client.status["last"]) == (4, client.run_info and len(client.series) - 1)
    assert (tmp_path / "out" / "map.png").is_file()


def run_viewed(call, monkeypatch, client, *command):
    """Run a command that ends with -o OUT with a viewer, for whom it stays until the end is seen."""
    port, enter = free_port(), LivePage.__enter__
    viewer = threading.Thread(target=look, args=(f"http://127.0.0.1:{port}/", client, command[-1]))

    def seen(page):
        entered = enter(page)
        viewer.start()
        assert page.wait_for_viewer(10)
        return entered

    monkeypatch.setattr(LivePage, "__enter__", seen)
    done = call(*command, "--live", "--live-port", port)
    viewer.join(10)
    return done


def test_a_taken_port_is_bad_usage_and_nothing_is_written(call, log, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        status, _, err = call("map", log, "-o", tmp_path / "out", "--live", "--live-port", port)
    assert status == 2
    assert "is taken; --live-port 0" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--live-port", "0"], "--live-port needs --live"),
        (["--live-host", "0.0.0.0"], "--live-host needs --live"),
        (["--open"], "--open needs --live"),
        (["--live", "--live-speed", "0"], "--live-speed: expected a number > 0"),
        (["--live", "--live-port", "70000"], "--live-port: expected a number from 0 to 65535"),
    ],
)
def test_options_that_do_not_fit(call, log, tmp_path, arguments, says):
    status, _, err = call("map", log, "-o", tmp_path / "out", *arguments)
    assert status == 2
    assert says in err


def test_view_says_what_is_no_result_of_a_run(call, tmp_path):
    status, _, err = call("view", tmp_path)
    assert status == 2
    assert "run.json: no such file; expected the folder that gridslam map, localize, grid or merge wrote" in err


@pytest.mark.parametrize("has_diagnosis", [False, True])
def test_view_serves_until_interrupted_which_is_a_good_end(call, log, mapped, tmp_path, has_diagnosis):
    """Of a folder with a diagnosis, too, it shows the run."""
    if has_diagnosis:
        call("doctor", log, "-o", tmp_path / "out")
    out = shutil.copytree(mapped, tmp_path / "out", dirs_exist_ok=True)
    assert (out / "report.txt").is_file() == has_diagnosis
    command = [sys.executable, "-u", "-m", "gridslam", "view", str(out), "--live-port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view:
        line = view.stdout.readline()
        url = line.split("open ")[1].split(" ")[0]
        client = PageClient()
        with connect(url.replace("http", "ws", 1) + "socket", max_size=None) as channel:
            client.receive(channel.recv(20))
        assert client.run_info["mode"] == "replay"
        view.send_signal(signal.SIGINT)
        assert view.wait(10) == 0
