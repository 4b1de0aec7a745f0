"""Faults in a node's session: what was mapped before is saved each time, and mapping goes on after those that pass."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.io.csv import CsvLog
from support.node_faults import AFTER, BEFORE, FAULTS, make_drive, run_fault

NODE = """
import sys, threading, time
from contextlib import nullcontext
from gridslam.cli.output import handle_signals, stop_if_interrupted
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.transport import RunOptions
from support.node_faults import QUICK, SHIFT_NS, make_drive
from support.ros_node import LocalTransport, mounting, play

def drive():
    for k, measurement in enumerate(make_drive()):
        play(node.core, transport.outputs, [measurement], shift_ns=SHIFT_NS)
        time.sleep(0.02)
        print(k + 1, flush=True)

with handle_signals(until_exit=True):
    transport = LocalTransport()
    parameters = {**QUICK, "out": sys.argv[1], "record": sys.argv[2]}
    node = RosNode(transport, node_parameters(parameters, "default"))
    node.core.on_transforms([mounting()], static=True)
    threading.Thread(target=drive, daemon=True).start()
    node.run(RunOptions(on_poll=stop_if_interrupted))
"""


@pytest.mark.parametrize("stays", [False, True], ids=["once", "stays"])
@pytest.mark.parametrize("name", FAULTS)
def test_what_was_mapped_is_saved(tmp_path, name, stays):
    found = run_fault(name, make_drive(seed=2 if stays else 1), tmp_path, stays=stays)
    assert found["error"] is None, found["log"]
    assert found["saved"] >= BEFORE - 1, found["log"]  # the last one may still be at work when the fault begins
    if not stays and "stamp" not in name:
        lost = 6 if "clock" in name else 2  # scans that wait when a clock is set are dropped
        assert found["saved"] >= BEFORE + AFTER - lost, found["log"]


def run_node(folder, until, *signals):
    """Run a node in a process, until it has been sent so many scans; then send signals to it."""
    folder.mkdir(exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", NODE, str(folder / "out"), str(folder / "scans.csv")]
    run = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while int(run.stdout.readline()) < until:
        continue
    for number in signals:
        run.send_signal(number)
        time.sleep(0.01)
    _, problem = run.communicate(timeout=120)
    return run.returncode, problem


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_save_the_map_however_many_come(tmp_path, number, seed):
    scans = 20 + 17 * seed
    status, problem = run_node(tmp_path, scans, *[number] * (1 + 4 * seed))
    assert (status, problem) == (0, "")
    assert json.loads((tmp_path / "out" / "run.json").read_text())["scans"]["read"] >= scans - 5


@pytest.mark.parametrize("seed", range(3))
def test_a_node_that_is_killed_leaves_its_record_and_the_next_one_keeps_it(tmp_path, seed):
    scans = 20 + 17 * seed
    status, _ = run_node(tmp_path, scans, signal.SIGKILL)
    assert status == -signal.SIGKILL
    assert len(list(CsvLog(tmp_path / "scans.csv"))) >= scans - 5
    run_node(tmp_path, 30, signal.SIGINT)
    assert len(list(CsvLog(tmp_path / "scans.csv"))) >= scans - 5
    assert (tmp_path / "scans-2.csv").exists()
    result = map_log(tmp_path / "scans.csv", configuration=Configuration(particles=3), repair="none")
    assert len(result.trajectory) >= scans - 5
