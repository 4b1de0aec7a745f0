"""A node ends well by every signal, at any time, and its log is whole lines."""

import signal
import subprocess
import sys

import pytest

from gridslam.io.maps import write_map
from support.dds_peer import Node, free_domain
from support.localization_world import flat_map


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs POSIX's signals")
def test_sigint_ends_a_node_that_a_script_has_started_in_its_background(tmp_path):
    """Where there is no job control, a shell lets what it starts with & ignore SIGINT."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        node = Node(free_domain(), tmp_path / "log")
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        assert node.says("waiting for scans")
        assert node.end(signal.SIGINT) == 0, node.log.read_text()
    finally:
        node.kill()


READS_FOR_LONG = """
import os, sys, time
import gridslam.ros.node.parameters as parameters
from gridslam.cli.main import main

def known_map(*arguments):
    os.write(1, b"reading\\n")
    time.sleep(60)

parameters.known_map = known_map
sys.exit(main())
"""


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
    command = [sys.executable, "-c", READS_FOR_LONG, "ros2", "--transport", "dds", "--map", str(tmp_path / "flat.yaml")]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert run.stdout.readline() == "reading\n"
        run.send_signal(number)
        assert run.communicate(timeout=30) == ("", "")
        assert run.returncode == 0
    finally:
        run.kill()
