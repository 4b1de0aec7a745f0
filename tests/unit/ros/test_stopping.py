"""A node ends well by every signal, at any time, and its log is whole lines."""

import signal
import subprocess
import sys

import pytest

from gridslam.io.maps import write_map
from support.house import ROOT
from support.localization_world import flat_map

NODE = f"""
import os, sys, time
import gridslam.ros.node.parameters as parameters
import gridslam.ros.ros2.rclpy_transport as rclpy_transport
from gridslam.cli.main import main
from gridslam.ros.node.ros_node import RosNode

sys.path.append({str(ROOT / "tests")!r})
from support.ros_node import LocalTransport

def known_map(*arguments):
    os.write(1, b"reading\\n")
    while True:
        time.sleep(0.01)  # a signal just before a sleep is handled after it

def run_without_ros(arguments, options):
    transport = LocalTransport()
    transport.outputs.log = lambda level, text: print(text, flush=True)
    RosNode(transport, parameters.node_parameters(options.given, "default")).run(options)

parameters.known_map = known_map
rclpy_transport.run_rclpy = run_without_ros
sys.exit(main())
"""


def start(*arguments):
    command = [sys.executable, "-c", NODE, "ros2", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs POSIX's signals")
def test_sigint_ends_a_node_that_a_script_has_started_in_its_background():
    """Where there is no job control, a shell lets what it starts with & ignore SIGINT."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        run = start()
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        assert run.stdout.readline().startswith("waiting for scans")
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=30)
        assert (run.returncode, err) == (0, ""), out
    finally:
        run.kill()


IN_GENERATED_CODE = """
import os, signal, sys
from gridslam.cli.output import end_by_signal, handle_signals

with handle_signals(until_exit=True), end_by_signal():
    exec("os.kill(os.getpid(), signal.SIGINT); sys.exit(3)")
sys.exit(0)
"""


def test_a_signal_amid_code_that_is_being_generated_ends_the_process_as_any_other(tmp_path):
    """As encoders of messages are made when they are first used: Python itself would end the process by SIGINT."""
    (tmp_path / "generated.py").write_text(IN_GENERATED_CODE)
    assert subprocess.run([sys.executable, "-m", "generated"], cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_while_the_map_is_read_ends_the_node_as_later(tmp_path, number):
    write_map(tmp_path / "flat.yaml", flat_map())
    run = start("--map", str(tmp_path / "flat.yaml"))
    try:
        assert run.stdout.readline() == "reading\n"
        run.send_signal(number)
        assert run.communicate(timeout=30) == ("", "")
        assert run.returncode == 0
    finally:
        run.kill()
