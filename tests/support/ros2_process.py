"""The command `gridslam ros2` in a process, in a domain of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from support.ros_node import until

_HELD: list[socket.socket] = []


def free_domain() -> int:
    """A domain that no other process of these tests uses: each holds a lock on one of its ports."""
    for k in range(99):
        domain = 1 + (os.getpid() + k) % 99
        held = socket.socket()
        try:
            held.bind(("127.0.0.1", 7400 + 250 * domain))  # of TCP, which DDS leaves alone
        except OSError:
            held.close()
            continue
        _HELD.append(held)
        return domain
    raise OSError("all domains are in use")


class Node:
    """The command, in a process of its own."""

    def __init__(self, domain: int, log: Path, *arguments: str) -> None:
        others = "ROS", "FASTRTPS", "PYTHON"
        environment = {name: value for name, value in os.environ.items() if not name.startswith(others)}
        environment |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        command = [sys.executable, "-m", "gridslam", "ros2", *arguments]
        self.log = log
        with log.open("w") as out:
            self.process = subprocess.Popen(command, env=environment, stderr=out, start_new_session=True)

    def says(self, words: str, seconds: float = 60.0) -> bool:
        """Wait for words in its log, as long as it runs."""
        until(lambda: words in self.log.read_text() or self.process.poll() is not None, seconds)
        return words in self.log.read_text()

    def end(self, number: int = signal.SIGINT) -> int:
        """Ctrl-C, or another signal."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(60)

    def kill(self) -> None:
        """End it without a word."""
        self.process.kill()
        self.process.wait(60)
