"""Faults of a live session: page, log and diagnostics report the same state and the same messages."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from websockets.sync.client import connect

from gridslam.cli.live import node_page
from gridslam.live.options import LiveOptions
from gridslam.localization import KnownMap, MonteCarloConfiguration
from gridslam.messages import Level, Messages
from gridslam.ros import NodeCore, NodeSettings
from gridslam.ros.node.accepted_scan import ScanRecorder
from gridslam.ros.node.node_state import NodeFacts, find_state
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.session import Localization
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map
from support.node_faults import SHIFT_NS, make_drive
from support.page_client import PageClient
from support.ros_node import ODOM, RecordedOutputs, in_filter, mounting, odometry_message, play, scan_message, until

DOCS = Path(__file__).parents[3] / "docs" / "ros.md"
MCL = MonteCarloConfiguration()


class Live:
    """A node that maps or localizes, and its page."""

    def __init__(self, tmp_path: Path, patch: pytest.MonkeyPatch, task: str) -> None:
        self.patch, self.outputs, self.client = patch, RecordedOutputs(), PageClient()
        self.out = tmp_path / "out"
        if task == "map":
            configuration = node_parameters({"particles": 3}, "default").configuration
            self.drive = make_drive()
        else:
            configuration = Localization(KnownMap(flat_map()), MCL)
            self.drive = list(flat_drive(3).measurements)
        settings = NodeSettings(queue_s=60.0, transform_wait_s=0.05)
        self.core = NodeCore(settings, configuration, self.outputs, record=tmp_path / "scans.csv")
        self.core.on_transforms([mounting()], static=True)
        self.at = 0

    def play(self, count: int = 10, *, shift_s: float = 0.0) -> None:
        """Send the next scans and their odometry."""
        shift_ns = SHIFT_NS + round(shift_s * 1e9)
        play(self.core, self.outputs, self.drive[self.at : self.at + count], shift_ns=shift_ns, ahead=5)
        self.at += count
        self.settle()

    def scans(self, count: int = 2, *, odometry: bool = False, **changes: object) -> None:
        """Send scans that are changed, with their odometry or without."""
        for measurement in self.drive[self.at : self.at + count]:
            if odometry:
                self.core.on_transforms([odometry_message(measurement, SHIFT_NS)])
            self.outputs.clock_ns = measurement.scan.stamp_ns + SHIFT_NS
            self.core.on_scan(scan_message(measurement, SHIFT_NS, **changes), "/scan")
        self.at += count
        self.settle()

    def settle(self) -> None:
        counts = self.core._queue.counts

        def done() -> int:
            return counts.accepted + counts.refused + counts.dropped + counts.paused

        assert until(lambda: done() == counts.received), vars(counts)
        in_filter(self.core)

    def pass_time(self, seconds: float, *, still_come: bool = False) -> None:
        """Let time pass, as the state sees it, in which scans still come or not."""
        publisher, queue = self.core._publisher, self.core._queue
        publisher._arrived_s -= seconds
        if queue.received_s is not None and not still_come:
            queue.received_s -= seconds

    def restart(self) -> None:
        """Play the log from its beginning."""
        self.play(20)
        self.at = 0
        self.play(10)

    def break_filter(self) -> None:
        def fail(*arguments: object) -> None:
            raise SystemError("injected")

        self.core._queue.take = fail
        self.core._queue.post(lambda: None)
        assert self.core.ended.wait(10)

    def fill_disk(self) -> None:
        def full(recorder: ScanRecorder, line: str) -> None:
            raise OSError(28, "No space left on device")

        self.patch.setattr(ScanRecorder, "_write", full)
        self.play()

    def publish_twice(self) -> None:
        odometry = odometry_message(self.drive[0], SHIFT_NS)
        self.core.on_transforms([odometry, odometry._replace(parent="wheels")])
        self.play()

    def publish_map_to_odom(self) -> None:
        self.play(2)
        foreign = odometry_message(self.drive[0], SHIFT_NS)._replace(parent="world", child=ODOM)
        self.core.on_transforms([foreign])
        self.play()

    def jump_odometry(self) -> None:
        self.play(5)
        moved = self.drive[self.at :]
        self.drive[self.at :] = [
            one._replace(odometry=replace(one.odometry, pose=one.odometry.pose + np.array([30.0, 0.0, 0.0])))
            for one in moved
        ]
        self.play()

    def set_clock(self) -> None:
        real = self.outputs.now_ns
        self.patch.setattr(self.outputs, "now_ns", lambda: real() + 3 * 365 * 86_400 * 10**9)
        self.play()

    def be_elsewhere(self) -> None:
        """Be where the map is known, and then drive through another world."""
        self.core.set_pose((np.array(self.drive[0].odometry.pose), np.diag([0.01, 0.01, 0.01])))
        self.play(20)
        self.drive[self.at :] = [
            one._replace(scan=replace(one.scan, ranges=np.full(len(one.scan.ranges), 0.4)))
            for one in self.drive[self.at :]
        ]
        self.play(40)


class Fault(NamedTuple):
    """A fault: what happens, the state that is reported, and the message."""

    happens: Callable[[Live], object]
    state: str
    text: str
    message: str = ""
    level: str = "warning"
    task: str = "map"


FAULTS = {
    "nothing is published": Fault(lambda live: None, "waiting", "waiting for scans on /scan and for base_link in odom"),
    "no odometry": Fault(
        lambda live: live.scans(), "no transforms", "no transform from 'base_link' to 'odom'", "missing transform"
    ),
    "wrong frame of the laser": Fault(
        lambda live: (live.play(1), live.pass_time(8), live.scans(odometry=True, frame="elsewhere")),
        "no transforms",
        "no transform from 'elsewhere'",
        "missing transform",
    ),
    "the laser is unplugged": Fault(
        lambda live: (live.play(), live.pass_time(8)), "no scans", r"no scans on /scan since \d\d:\d\d:\d\d"
    ),
    "scans of three beams": Fault(
        lambda live: (live.play(), live.pass_time(8), live.scans(ranges=np.ones(3, np.float32))),
        "no scans",
        "no scan accepted on /scan since",
        "scan refused: /scan: 3 beams",
    ),
    "a bag is played again": Fault(
        Live.restart, "running", "mapping", "starting a new map: time jumped back", level="error"
    ),
    "clocks differ": Fault(Live.set_clock, "running", "mapping", "clock differs: scans are stamped 3.0 years before"),
    "the wheels' driver restarts": Fault(Live.jump_odometry, "running", "mapping", "odometry jumped: by 3"),
    "the disk is full": Fault(Live.fill_disk, "running", "mapping", "record: "),
    "the base has two parents": Fault(Live.publish_twice, "running", "mapping", "two transforms: base_link is"),
    "another localization runs": Fault(Live.publish_map_to_odom, "running", "mapping", "transform of another node"),
    "paused": Fault(lambda live: (live.play(), live.core.pause(True)), "paused", "paused"),
    "the filter fails": Fault(Live.break_filter, "failed", "the filter failed: SystemError: injected", level="error"),
    "the pose is unknown": Fault(
        lambda live: live.play(2), "looking", "looking for the robot in the whole map", task="localize"
    ),
    "the robot is elsewhere": Fault(
        Live.be_elsewhere, "lost", "lost: the pose or the map may be wrong", task="localize"
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_page_log_and_diagnostics_report_the_same(name, tmp_path, monkeypatch, capsys):
    fault = FAULTS[name]
    live = Live(tmp_path, monkeypatch, fault.task)
    core, outputs, seen = live.core, live.outputs, live.client
    with node_page(LiveOptions(port=0), "robot", core):
        url = capsys.readouterr().err.split("live at ")[1].split()[0]
        core.start()
        core.await_input("/scan", "for base_link in odom")
        fault.happens(live)
        if not core.ended.is_set():
            core._publish_diagnostics()
        told = outputs.reports[-1]
        assert told.state == fault.state, told
        assert re.match(fault.text, told.values["state"])
        assert told.summary.startswith(told.values["state"])
        assert (told.level is Level.OK) == (fault.state not in _NOT_GREEN and not fault.message), told
        logged = [text for _, text in outputs.logs]
        assert told.values["state"] in logged
        with connect(url.replace("http", "ws", 1) + "socket", max_size=None) as line:

            def is_shown() -> bool:
                seen.receive(line.recv(10))
                words = told.values["state"]
                is_listed = any(message["text"] == words for message in seen.reported)
                return is_listed and (seen.status["stage"], seen.status["state"]) == (fault.state, words)

            assert until(is_shown), seen.status
        on_page = {(message["level"], message["text"]) for message in seen.reported}
        if fault.message:
            assert any(level == fault.level and text.startswith(fault.message) for level, text in on_page), on_page
            assert any(text.startswith(fault.message) for text in logged), logged
        core.close()


_NOT_GREEN = "lost", "failed", "no scans", "no transforms", "waiting"


def test_the_end_is_reported_and_run_json_has_the_messages_of_the_page(tmp_path, monkeypatch):
    live = Live(tmp_path, monkeypatch, "map")
    live.core.start()
    live.jump_odometry()
    document = live.core.save(live.out)
    assert document["messages"] == live.core.messages.to_list()
    assert any(message["text"].startswith("odometry jumped") for message in document["messages"])
    live.core.close()
    assert (live.outputs.reports[-1].state, live.outputs.reports[-1].values["state"]) == ("finished", "finished")


def test_of_several_states_the_most_urgent_one_is_reported():
    fine = NodeFacts(100.0, received_s=99.0, accepted_s=99.0)
    assert find_state(fine).name == "running"
    silent = replace(fine, accepted_s=90.0, missing_transform="no transform")
    assert find_state(silent).name == "no transforms"
    assert find_state(replace(silent, received_s=90.0)).name == "no scans"
    assert find_state(replace(silent, is_paused=True)).name == "paused"
    assert find_state(replace(silent, is_paused=True, is_closed=True)).name == "finished"
    assert find_state(replace(fine, lost=True, looking=True)).name == "looking"
    assert find_state(replace(fine, is_closed=True, failure="it")).name == "failed"


def test_the_table_of_the_docs_is_that_of_the_test():
    table = DOCS.read_text(encoding="utf-8").partition("| fault | state |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[2:]]
    assert [row[0] for row in rows] == list(FAULTS)
    for fault, row in zip(FAULTS.values(), rows, strict=True):
        assert row[1] == fault.state, row
        assert re.match(fault.text, row[2]), row
        assert bool(fault.message) == bool(row[3]), row
        assert fault.message.split(":")[0] in row[3], row


def test_messages_keep_count_level_and_times_and_forget_the_least():
    now = [0.0]
    messages = Messages(lambda level, text: None, clock=lambda: now[0], now_s=lambda: 1000.0 + now[0])
    messages.report(Level.ERROR, "the disk is full")
    for now[0] in (1.0, 2.0, 3.0):
        messages("late", f"by {now[0]} s")
    newest, oldest = messages.to_list()
    assert newest == {
        "level": "warning", "text": "late: by 3.0 s", "count": 3, "first_s": 1001.0, "last_s": 1003.0, "state": False
    }  # fmt: skip
    assert oldest["text"] == "the disk is full"
    for number in range(400):
        messages.report(Level.WARN, "another " + "x" * number)
    assert len(messages.to_list()) == 256
    assert messages.to_list()[-1]["text"] == "the disk is full", "an error outlives warnings"
