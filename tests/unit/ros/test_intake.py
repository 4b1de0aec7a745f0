"""Scans wait for their transforms, the newest win, and what is refused is named."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest

from gridslam.io.ros_messages import ScanMessage, StampedTransform
from gridslam.ros.accepted import Accepted, refusal_of
from gridslam.ros.complaints import Complaints
from gridslam.ros.intake import Intake, Turn
from gridslam.ros.messages import Level
from gridslam.ros.settings import NodeSettings
from support.ros_node import BASE, LASER, ODOM, mounting

S = 10**9
START = 1_700_000_000 * S


class Desk:
    """An intake with a clock that stands still, and what it complained of."""

    def __init__(self, **settings: object) -> None:
        self.now_s = 100.0
        self.said: list[str] = []
        self.complain = Complaints(lambda level, text: self.said.append(text), clock=lambda: self.now_s)
        self.intake = Intake(NodeSettings(**settings), self.complain, lambda: self.now_s)
        self.intake.add_transforms([mounting()], static=True)

    def scan(self, at_s: float, **changes: object) -> None:
        message = ScanMessage(START + round(at_s * S), LASER, -1.0, 0.1, 0.0, 0.1, 30.0, np.ones(20, np.float32))
        self.intake.add_scan(message._replace(**changes), "/scan")

    def odometry(self, at_s: float, x: float = 0.0) -> None:
        pose = (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.intake.add_transforms([StampedTransform(START + round(at_s * S), ODOM, BASE, pose)])

    def taken(self) -> list[float]:
        """Times of the scans that need not wait."""
        times = []
        self.intake.post(lambda: None)
        while True:
            with self.intake._changed:
                found, _ = self.intake._head()
            if not isinstance(found, Accepted):
                return times
            times.append((found.measurement.scan.stamp_ns - START) / S)


def test_a_scan_waits_for_the_odometry_after_it_which_is_interpolated():
    desk = Desk()
    desk.odometry(0.0, x=1.0)
    desk.scan(0.05)
    assert desk.taken() == []
    desk.odometry(0.1, x=2.0)
    with desk.intake._changed:
        found, _ = desk.intake._head()
    np.testing.assert_allclose(found.measurement.odometry.pose, [1.5, 0, 0])
    assert desk.said == []


def test_a_scan_whose_odometry_does_not_come_is_refused_with_the_very_link():
    desk = Desk(transform_wait_s=0.5)
    desk.odometry(0.0)
    desk.scan(0.05)
    desk.now_s += 0.49
    assert desk.taken() == []
    assert desk.said == []
    desk.now_s += 0.02
    assert desk.taken() == []
    assert desk.intake.counts.refused == 1
    assert f"the link {ODOM} <- {BASE} is known only until" in desk.said[0]
    desk.odometry(0.2)
    assert desk.taken() == []


def test_a_scan_from_before_the_first_odometry_is_refused_at_once():
    desk = Desk()
    desk.odometry(1.0)
    desk.scan(0.5)
    desk.scan(1.0)
    assert desk.taken() == [1.0]
    assert "is known only from" in desk.said[0]


def test_what_is_wrong_is_said_once_a_second_with_its_count():
    desk = Desk()
    desk.odometry(0.0)
    desk.odometry(10.0)
    for k in range(25):
        desk.scan(0.1 * k, frame="elsewhere")
        desk.now_s += 0.1
        desk.taken()
    desk.now_s += 1.0
    desk.taken()
    assert desk.intake.counts.refused == 25
    said = [text for text in desk.said if text.startswith("missing transform")]
    assert len(said) <= 4
    assert "no link names" in said[0]
    assert "'elsewhere'" in said[0]
    assert "times more before" in said[1]


@pytest.mark.parametrize("odometry", ["optional", "none"])
def test_odometry_may_be_missing_where_that_is_said(odometry):
    desk = Desk(odometry=odometry, transform_wait_s=0.3)
    desk.scan(0.0)
    desk.now_s += 0.31
    assert desk.taken() == [0.0]
    assert ("scan without odometry" in "".join(desk.said)) == (odometry == "optional")


def test_the_newest_scans_win_and_the_others_are_counted():
    desk = Desk(queue_scans=4, queue_s=100)
    desk.odometry(0.0)
    desk.odometry(10.0)
    for k in range(10):
        desk.scan(0.1 * k)
    assert desk.taken() == pytest.approx([0.6, 0.7, 0.8, 0.9])
    assert desk.intake.counts.dropped == 6


def test_what_is_too_old_when_a_newer_one_comes_is_dropped():
    desk = Desk(queue_s=0.25)
    desk.odometry(0.0)
    desk.odometry(10.0)
    for k in range(10):
        desk.scan(0.1 * k)
        desk.now_s += 0.1
    assert desk.taken() == pytest.approx([0.7, 0.8, 0.9])


def test_every_third_scan_is_taken_where_that_is_asked_for():
    desk = Desk(throttle_scans=3)
    desk.odometry(0.0)
    desk.odometry(10.0)
    for k in range(7):
        desk.scan(float(k))
    assert desk.taken() == [0, 3, 6]
    assert desk.intake.counts.throttled == 4


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"ranges": np.ones(3, np.float32)}, "3 beams are too few"),
        ({"ranges": np.broadcast_to(np.float32(1), 26_214_400)}, "26214400 beams, more than the 100000"),
        ({"stamp_ns": 0}, "expected a stamp of more than 0 s"),
        ({"stamp_ns": math.nan}, "expected a stamp"),
        ({"frame": ""}, "expected the name of a frame"),
        ({"frame": "laser\nfake"}, "expected the name of a frame"),
        ({"range_min": math.inf}, "its least range is infinite"),
        ({"angle_min": math.nan}, "expected beams within one turn"),
        ({"angle_increment": math.inf}, "expected beams within one turn"),
        ({"angle_increment": 0.0}, "expected beams within one turn"),
        ({"angle_increment": 1.0}, "expected beams within one turn"),
    ],
)
def test_a_wrong_scan_is_refused_by_name_and_the_next_one_is_taken(change, says):
    desk = Desk()
    desk.odometry(0.0)
    desk.odometry(10.0)
    desk.scan(1.0, **change)
    desk.scan(2.0)
    assert desk.taken() == [2.0]
    assert says in desk.said[0]
    assert desk.intake.counts.refused == 1


def test_a_good_scan_is_not_refused():
    message = ScanMessage(1, LASER, -math.pi, math.tau / 720, 0.0, 0.1, 30.0, np.ones(720, np.float32))
    assert refusal_of(message, 10, 100_000) == ""


@pytest.mark.parametrize("pose", [(math.nan,) * 7, (0.0,) * 7, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0)])
def test_a_transform_that_is_none_is_named_and_the_others_are_taken(pose):
    desk = Desk()
    good = StampedTransform(START, ODOM, BASE, (0.0,) * 6 + (1.0,))
    desk.intake.add_transforms([StampedTransform(START, ODOM, BASE, pose), good])
    desk.scan(0.0)
    assert desk.taken() == [0.0]
    assert f"transform refused: {ODOM} <- {BASE}" in desk.said[0]


def run_of(desk: Desk, start_s: float, x: float, scans: int = 5) -> None:
    for k in range(scans):
        desk.odometry(start_s + 0.1 * k, x + 0.05 * k)
        desk.scan(start_s + 0.1 * k)


@pytest.mark.parametrize("back_s", [3.0, 60.0])
def test_a_log_that_is_played_twice_begins_a_new_session(back_s):
    desk = Desk()
    run_of(desk, 100.0, 7.0)
    assert len(desk.taken()) == 5
    run_of(desk, 100.0 - back_s, 0.0)
    with desk.intake._changed:
        assert desk.intake._head()[0] is Turn.JUMP
    assert desk.taken() == pytest.approx([100.1 - back_s + 0.1 * k for k in range(4)])
    assert "stamp jumped back" in desk.said[0]
    assert desk.intake.counts.jumps == 1


@pytest.mark.parametrize("patience", [True, False])
def test_a_log_that_is_played_twice_begins_a_new_session_though_its_transforms_come_late(patience):
    """The jump is not forgotten with the scan that was refused for want of its transform."""
    desk = Desk(transform_wait_s=1.0)
    run_of(desk, 100.0, 7.0)
    assert len(desk.taken()) == 5
    for k in range(3):
        desk.scan(40.0 + 0.1 * k)
    assert desk.taken() == []
    if not patience:
        desk.now_s += 2.0
        assert desk.taken() == []
        assert len(desk.intake._queue) == 0
    run_of(desk, 40.3, 0.0)
    desk.now_s += 2.0
    with desk.intake._changed:
        assert desk.intake._head()[0] is Turn.JUMP
    assert desk.taken() == pytest.approx([40.4, 40.5, 40.6, 40.7])


def test_a_clock_that_was_set_back_is_no_new_session():
    desk = Desk()
    run_of(desk, 100.0, 7.0)
    desk.taken()
    run_of(desk, 90.0, 7.25)
    assert desk.taken() == pytest.approx([90.1, 90.2, 90.3, 90.4])


def test_a_single_stamp_that_is_astray_ends_nothing():
    desk = Desk()
    run_of(desk, 100.0, 0.0)
    desk.scan(50.0)
    run_of(desk, 100.5, 0.25)
    assert len(desk.taken()) == 10
    assert desk.intake.counts.jumps == 0


def test_take_waits_in_one_thread_for_what_another_brings():
    desk = Desk()
    taken: list[object] = []
    thread = threading.Thread(target=lambda: taken.extend(desk.intake.take() for _ in range(2)))
    thread.start()
    desk.odometry(0.0)
    desk.scan(0.0)
    desk.intake.turn(Turn.CLOSED)
    thread.join(5)
    assert not thread.is_alive()
    assert Turn.CLOSED in taken
    assert desk.intake.take() is Turn.CLOSED


def test_levels_are_those_of_diagnostic_messages():
    assert [level.value for level in (Level.OK, Level.WARN, Level.ERROR)] == [0, 1, 2]


def test_odometry_that_jumps_is_named():
    """The base's driver was started again: the scan is taken, and the filter goes by the scans."""
    desk = Desk()
    for at_s, x in ((0.0, 7.0), (0.1, 7.05), (0.2, 0.0), (0.3, 0.05)):
        desk.odometry(at_s, x)
        desk.scan(at_s)
        assert desk.taken() == [at_s]
    assert desk.said == ["odometry jumped: by 7.05 m and 0.00 rad in 0.1 s"]


def link(at_s: float, parent: str, child: str = BASE) -> StampedTransform:
    return StampedTransform(START + round(at_s * S), parent, child, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def test_two_publishers_of_one_transform_are_named():
    desk = Desk()
    for at_s, publisher in ((0.0, "/wheels"), (0.02, "/ekf"), (0.1, "/wheels"), (0.12, "/ekf")):
        desk.intake.add_transforms([link(at_s, ODOM)], publisher=publisher)
    assert desk.said == [
        "two transforms: base_link is published twice (in odom by /ekf and in odom by /wheels): "
        "stop one of the two publishers"
    ]


def test_two_parents_of_one_frame_are_named():
    desk = Desk()
    desk.intake.add_transforms([link(0.0, "odom_combined")], publisher="/ekf")
    desk.intake.add_transforms([link(0.01, ODOM)], publisher="/wheels")
    desk.intake.add_transforms([link(0.0, "base_footprint")], static=True, publisher="/urdf")
    assert "base_link is published twice (in odom by /wheels and in odom_combined by /ekf)" in desk.said[0]
    assert desk.complain.counts["two transforms"] == 3


def test_a_publisher_that_took_over_or_says_the_same_forever_is_none_of_two():
    desk = Desk()
    desk.intake.add_transforms([link(0.0, ODOM)], publisher="/base_1")
    desk.intake.add_transforms([link(5.0, ODOM)], publisher="/base_2")
    for at_s in (0.0, 1.0):  # a fixed joint, latched by one and repeated by another
        desk.intake.add_transforms([link(at_s, BASE, "imu")], static=True, publisher="/urdf")
        desk.intake.add_transforms([link(at_s, BASE, "imu")], publisher="/repeater")
    assert desk.said == []


def test_a_scan_that_comes_twice_is_taken_once():
    desk = Desk()
    desk.odometry(0.0)
    desk.odometry(0.3)
    for at_s in (0.1, 0.1, 0.2):
        desk.scan(at_s)
    desk.intake.add_transforms([mounting()._replace(child="rear")], static=True)
    desk.scan(0.2, frame="rear")  # two lasers may share a topic
    assert desk.taken() == [0.1, 0.2, 0.2]
    assert "scan refused: /scan: one of this stamp has come" in desk.said[0]


def test_scans_of_a_slow_clock_are_named():
    """The transforms of a while ago are known, so that all seems well; but where the robot turns walls are doubled."""
    desk = Desk()
    for k in range(50):
        desk.odometry(0.1 * k)
        desk.scan(0.1 * k - (0.9 if k == 30 else 0.4))  # late, but only one much
    assert desk.said == []
    for k in range(50, 61):
        desk.odometry(0.1 * k)
        desk.scan(0.1 * k - 0.9)
    assert desk.said[0].startswith("late scans: /scan is stamped 0.90 s before the odometry that came")


def test_a_lidar_that_sees_nothing_is_named():
    desk = Desk()
    desk.odometry(0.0)
    desk.scan(0.0, ranges=np.full(20, np.nan, np.float32))
    assert desk.taken() == [0.0]
    assert desk.said == ["nothing seen: /scan: no beam of 20 hits anything in range"]
