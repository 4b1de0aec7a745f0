"""Scans wait for their transforms, the newest win, and what is refused is named."""

from __future__ import annotations

import math
import threading
from collections import Counter

import numpy as np
import pytest

from gridslam.io.bags.ros_messages import ScanMessage, StampedTransform
from gridslam.messages import Messages
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.ros.node.live_transforms import LiveTransforms
from gridslam.ros.node.measurement_queue import MeasurementQueue, SessionEnd
from gridslam.ros.node.parameters import NodeSettings
from gridslam.transforms import buffer
from support.ros_node import BASE, LASER, ODOM, mounting, until

S = 10**9
START = 1_700_000_000 * S


class QueueSetup:
    """A queue with a clock that stands still, and its logged warnings."""

    def __init__(self, **settings: object) -> None:
        self.now_s = 100.0
        self.logs: list[str] = []
        self.warn = Messages(lambda level, text: self.logs.append(text), clock=lambda: self.now_s)
        self.queue = MeasurementQueue(NodeSettings(**settings), self.warn, lambda: self.now_s)
        self.queue.add_transforms([mounting()], static=True)

    def scan(self, at_s: float, **changes: object) -> None:
        message = ScanMessage(START + round(at_s * S), LASER, -1.0, 0.1, 0.0, 0.1, 30.0, np.ones(20, np.float32))
        self.queue.add_scan(message._replace(**changes), "/scan")

    def odometry(self, at_s: float, x: float = 0.0) -> None:
        pose = (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.queue.add_transforms([StampedTransform(START + round(at_s * S), ODOM, BASE, pose)])

    def taken(self) -> list[float]:
        """Times of the scans that need not wait."""
        times = []
        self.queue.post(lambda: None)
        while True:
            with self.queue._changed:
                found, _ = self.queue._next_measurement()
            if not isinstance(found, AcceptedScan):
                return times
            times.append((found.measurement.scan.stamp_ns - START) / S)


def test_a_scan_waits_for_the_odometry_after_it_which_is_interpolated():
    setup = QueueSetup()
    setup.odometry(0.0, x=1.0)
    setup.scan(0.05)
    assert setup.taken() == []
    setup.odometry(0.1, x=2.0)
    with setup.queue._changed:
        found, _ = setup.queue._next_measurement()
    np.testing.assert_allclose(found.measurement.odometry.pose, [1.5, 0, 0])
    assert setup.logs == []


def test_a_scan_whose_odometry_does_not_come_is_refused_with_the_very_link():
    setup = QueueSetup(transform_wait_s=0.5)
    setup.odometry(0.0)
    setup.scan(0.05)
    setup.now_s += 0.49
    assert setup.taken() == []
    assert setup.logs == []
    setup.now_s += 0.02
    assert setup.taken() == []
    assert setup.queue.counts.refused == 1
    setup.odometry(0.2)
    assert setup.taken() == []
    assert setup.logs == []  # it may have been the end
    setup.scan(0.2)
    assert setup.taken() == [0.2]
    assert f"the link {ODOM} <- {BASE} is known only until" in setup.logs[0]


def test_late_odometry_is_extrapolated_with_its_velocity():
    """10 Hz, on an arc of 1 m/s and 1 rad/s: the scan waits 30 ms for the next reading, then goes on on the arc."""
    setup = QueueSetup()
    for k in range(4):
        angle = 0.1 * k
        turn = 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)
        pose = math.sin(angle), 1 - math.cos(angle), 0.0, *turn
        setup.queue.add_transforms([StampedTransform(START + k * S // 10, ODOM, BASE, pose)])
    setup.scan(0.36)
    assert setup.taken() == []
    setup.now_s += 0.031
    with setup.queue._changed:
        found, _ = setup.queue._next_measurement()
    np.testing.assert_allclose(found.measurement.odometry.pose, [math.sin(0.36), 1 - math.cos(0.36), 0.36], atol=1e-9)
    assert setup.queue.counts.extrapolated == 1
    assert setup.logs == []


@pytest.mark.parametrize(
    ("readings", "at_s", "settings"),
    [
        ([(0.0, 0.0), (0.1, 0.1)], 0.26, {}),  # too long after the last one
        ([(0.0, 0.0), (0.2, 0.1)], 0.25, {}),  # readings too far apart to say with what velocity it moves now
        ([(0.1, 0.1)], 0.15, {}),
        ([(0.0, 0.0), (0.1, 30.0)], 0.15, {}),  # a driver that was started again
        ([(0.0, 0.0), (0.1, 0.1)], 0.15, {"extrapolate_s": 0.0}),
    ],
)
def test_odometry_is_not_extrapolated_far(readings, at_s, settings):
    setup = QueueSetup(**settings)
    for when_s, x in readings:
        setup.odometry(when_s, x)
    setup.scan(at_s)
    setup.now_s += 0.1
    assert setup.taken() == []
    setup.odometry(0.3, 0.3)
    assert setup.taken() == [at_s]
    assert setup.queue.counts.extrapolated == 0


def test_what_is_wrong_is_said_once_a_second_with_its_count():
    setup = QueueSetup()
    setup.odometry(0.0)
    setup.odometry(10.0)
    for k in range(25):
        setup.scan(0.1 * k, frame="elsewhere")
        setup.now_s += 0.1
        setup.taken()
    setup.now_s += 1.0
    setup.taken()
    assert setup.queue.counts.refused == 25
    said = [text for text in setup.logs if text.startswith("missing transform")]
    assert len(said) <= 4
    assert "no link names" in said[0]
    assert "'elsewhere'" in said[0]
    assert "more before" in said[1]


@pytest.mark.parametrize("odometry", ["optional", "none"])
def test_odometry_may_be_missing_where_that_is_said(odometry):
    setup = QueueSetup(odometry=odometry, transform_wait_s=0.3)
    setup.scan(0.0)
    setup.now_s += 0.31
    assert setup.taken() == [0.0]
    assert ("scan without odometry" in "".join(setup.logs)) == (odometry == "optional")


def test_the_newest_scans_win_and_the_others_are_counted():
    setup = QueueSetup(queue_scans=4, queue_s=100)
    setup.odometry(0.0)
    setup.odometry(10.0)
    for k in range(10):
        setup.scan(0.1 * k)
    assert setup.taken() == pytest.approx([0.6, 0.7, 0.8, 0.9])
    assert setup.queue.counts.dropped == 6


class Filter(threading.Thread):
    """Takes scans as fast as they come, but where it is busy."""

    def __init__(self, setup: QueueSetup) -> None:
        super().__init__(daemon=True)
        self.setup, self.taken = setup, 0
        self.free = threading.Event()
        self.start()

    def run(self) -> None:
        while (found := self.setup.queue.take()) is not SessionEnd.CLOSED:
            if isinstance(found, AcceptedScan):
                self.taken += 1
            else:
                found()

    def is_busy(self) -> None:
        """Be busy until it is set free."""
        begun = threading.Event()
        self.free.clear()
        self.setup.queue.post(lambda: (begun.set(), self.free.wait(10)))
        assert begun.wait(10)

    def catches_up(self, count: int) -> bool:
        self.free.set()
        return until(lambda: self.taken >= count and not self.setup.queue._scans, 10)


@pytest.mark.parametrize(("rate_hz", "busy_s"), [(40.0, 6.0), (100.0, 7.5)])
def test_no_scan_is_lost_while_the_filter_is_busy_for_some_seconds(rate_hz, busy_s):
    """Again and again, as it catches up in between; half an hour at 40 Hz lost 283 scans in two such pauses."""
    setup = QueueSetup()
    setup.odometry(0.0)
    setup.odometry(9.0)
    works, sent = Filter(setup), 0
    for again in range(3):
        works.is_busy()
        for _ in range(round(rate_hz * busy_s)):
            setup.now_s += 1 / rate_hz
            sent += 1
            setup.scan(9.0 * sent / (3 * rate_hz * busy_s))
        assert works.catches_up(sent), (again, works.taken, setup.queue.counts.dropped)
    assert setup.queue.counts.dropped == 0
    setup.queue.end_session(SessionEnd.CLOSED)


def test_a_filter_that_never_catches_up_is_not_far_behind():
    """It takes 20 scans a second of 40; for some seconds all wait, then the oldest are dropped."""
    setup = QueueSetup()
    setup.odometry(0.0)
    setup.odometry(9.0)
    behind = []
    for k in range(1200):
        setup.now_s += 0.025
        setup.scan(0.0075 * k)
        if k % 2:
            found = setup.queue.take()
            assert isinstance(found, AcceptedScan)
            behind.append(setup.now_s - found.arrived_s)
    assert max(behind) < 8.0
    assert max(behind[200:]) <= 0.75 + 1e-9


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"ranges": np.ones(3, np.float32)}, "3 beams are too few"),
        ({"ranges": np.broadcast_to(np.float32(1), 26_214_400)}, "26214400 beams, more than the maximum of 100000"),
        ({"stamp_ns": 0}, "expected a stamp of more than 0 s"),
        ({"stamp_ns": math.nan}, "expected a stamp"),
        ({"frame": ""}, "expected the name of a frame"),
        ({"frame": "laser\nfake"}, "expected the name of a frame"),
        ({"range_min": math.inf}, "range_min is infinite"),
        ({"angle_min": math.nan}, "expected finite angles"),
        ({"angle_increment": math.inf}, "expected finite angles"),
        ({"angle_increment": 0.0}, "all point one way"),
        ({"angle_increment": 1.0}, "more than one turn"),
        ({"angle_max": 2.0}, "not at angle_max 2"),
    ],
)
def test_a_wrong_scan_is_refused_by_name_and_the_next_one_is_taken(change, says):
    setup = QueueSetup()
    setup.odometry(0.0)
    setup.odometry(10.0)
    setup.scan(1.0, **change)
    setup.scan(2.0)
    assert setup.taken() == [2.0]
    assert says in setup.logs[0]
    assert setup.queue.counts.refused == 1


@pytest.mark.parametrize("pose", [(math.nan,) * 7, (0.0,) * 7, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0)])
def test_a_transform_that_is_none_is_named_and_the_others_are_taken(pose):
    setup = QueueSetup()
    good = StampedTransform(START, ODOM, BASE, (0.0,) * 6 + (1.0,))
    setup.queue.add_transforms([StampedTransform(START, ODOM, BASE, pose), good])
    setup.scan(0.0)
    assert setup.taken() == [0.0]
    assert f"transform refused: {ODOM} <- {BASE}" in setup.logs[0]


def run_of(setup: QueueSetup, start_s: float, x: float, scans: int = 5) -> None:
    for k in range(scans):
        setup.odometry(start_s + 0.1 * k, x + 0.05 * k)
        setup.scan(start_s + 0.1 * k)


@pytest.mark.parametrize("back_s", [3.0, 60.0])
def test_a_log_that_is_played_twice_begins_a_new_session(back_s):
    setup = QueueSetup()
    run_of(setup, 100.0, 7.0)
    assert len(setup.taken()) == 5
    run_of(setup, 100.0 - back_s, 0.0)
    with setup.queue._changed:
        assert setup.queue._next_measurement()[0] is SessionEnd.JUMP
    assert setup.taken() == pytest.approx([100.1 - back_s + 0.1 * k for k in range(4)])
    assert "stamp jumped back" in setup.logs[0]
    assert setup.queue.counts.jumps == 1


def test_a_clock_that_was_set_back_is_no_new_session():
    setup = QueueSetup()
    run_of(setup, 100.0, 7.0)
    setup.taken()
    run_of(setup, 90.0, 7.25)
    assert setup.taken() == pytest.approx([90.1, 90.2, 90.3, 90.4])


def test_a_single_stamp_that_is_astray_ends_nothing():
    setup = QueueSetup()
    run_of(setup, 100.0, 0.0)
    setup.scan(50.0)
    run_of(setup, 100.5, 0.25)
    assert len(setup.taken()) == 10
    assert setup.queue.counts.jumps == 0


def test_take_waits_in_one_thread_for_what_another_brings():
    setup = QueueSetup()
    taken: list[object] = []
    thread = threading.Thread(target=lambda: taken.extend(setup.queue.take() for _ in range(2)))
    thread.start()
    setup.odometry(0.0)
    setup.scan(0.0)
    setup.queue.end_session(SessionEnd.CLOSED)
    thread.join(5)
    assert not thread.is_alive()
    assert SessionEnd.CLOSED in taken
    assert setup.queue.take() is SessionEnd.CLOSED


def test_odometry_that_jumps_is_named():
    """The base's driver was started again: the scan is taken, and the filter goes by the scans."""
    setup = QueueSetup()
    for at_s, x in ((0.0, 7.0), (0.1, 7.05), (0.2, 0.0), (0.3, 0.05)):
        setup.odometry(at_s, x)
        setup.scan(at_s)
        assert setup.taken() == [at_s]
    assert setup.logs == ["odometry jumped: by 7.05 m and 0.00 rad in 0.1 s"]


def link(at_s: float, parent: str, child: str = BASE) -> StampedTransform:
    return StampedTransform(START + round(at_s * S), parent, child, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def test_two_parents_at_a_time_are_named_and_not_one_after_the_other():
    setup = QueueSetup()
    for at_s, parent in ((0.0, ODOM), (0.1, ODOM), (0.2, "wheels"), (0.3, "wheels")):
        setup.queue.add_transforms([link(at_s, parent)])
    assert setup.logs == []
    setup.queue.add_transforms([link(0.4, ODOM)])
    assert setup.logs == [
        "two transforms: base_link is published twice (in odom and in wheels): stop one of the two publishers"
    ]


def test_a_scan_that_comes_twice_is_taken_once():
    setup = QueueSetup()
    setup.odometry(0.0)
    setup.odometry(0.3)
    for at_s in (0.1, 0.1, 0.2):
        setup.scan(at_s)
    setup.queue.add_transforms([mounting()._replace(child="rear")], static=True)
    setup.scan(0.2, frame="rear")  # two lasers may share a topic
    assert setup.taken() == [0.1, 0.2, 0.2]
    assert "scan refused: /scan: duplicate stamp" in setup.logs[0]


def test_made_up_frames_do_not_fill_the_memory(monkeypatch):
    """334,000 names of frames took a node to 844 MB: further transforms are refused, lasers' frames expire."""
    warned = Counter()
    monkeypatch.setattr(buffer, "_MOST_LINKS", 100)
    transforms = LiveTransforms(1.0, lambda kind, problem: warned.update([kind]))
    for k in range(3000):
        made_up = StampedTransform(k, "base_link", f"frame{k}", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        transforms.add([made_up], static=k % 2 == 0)
        again = made_up._replace(child="laser", parent=f"parent{k}")
        transforms.add([again], static=False)
    assert warned["transform refused"] > 1000
    for held in (transforms._static, transforms._latest_ns, transforms._parents, transforms._parents["laser"]):
        assert len(held) <= 100
    setup = QueueSetup()
    for k in range(1000):
        setup.scan(k / 10, frame=f"laser{k}")
    assert len(setup.queue._received_ns) <= 256


def test_the_missing_transform_is_that_of_the_last_scan_that_was_refused():
    """Else the state stays "no transforms" where scans are refused for another reason."""
    setup = QueueSetup(transform_wait_s=0.5)
    setup.scan(0.05)
    setup.now_s += 1.0
    assert setup.taken() == []
    assert setup.queue.missing_transform
    setup.scan(3.0, ranges=np.ones(3, np.float32))
    assert setup.queue.missing_transform == ""
