"""A log is held back, let go scan by scan, and timed; a filter that nobody holds never waits."""

from __future__ import annotations

import threading
import time

import pytest

from gridslam.errors import ArgumentError
from gridslam.live.control import Control, check_speed


class Filter(threading.Thread):
    """Takes scans, 0.1 s of the log apart; every third is a key scan."""

    def __init__(self, control, scans=1000):
        super().__init__(daemon=True)
        self.control, self.scans, self.taken, self.idle = control, scans, 0, 0

    def meanwhile(self):
        self.idle += 1

    def run(self):
        for scan in range(self.scans):
            self.control.wait(scan * 100_000_000, self.meanwhile)
            self.taken += 1
            if scan % 3 == 0:
                self.control.on_key_scan()


def wait_until(condition, at_most_s=5.0):
    until = time.perf_counter() + at_most_s
    while not condition():
        assert time.perf_counter() < until, "it did not happen"
        time.sleep(0.002)


def stays(value, what, for_s=0.06):
    time.sleep(for_s)
    assert what() == value


@pytest.fixture
def held():
    control = Control()
    control.pause()
    runner = Filter(control)
    runner.start()
    yield control, runner
    control.end()
    runner.join(5)
    assert not runner.is_alive()


def test_nobody_waits_where_nobody_holds():
    assert Control().wait(0, lambda: pytest.fail("there was a wait")) is False


def test_a_pause_holds_the_next_scan_and_gives_time_to_others(held):
    control, runner = held
    stays(0, lambda: runner.taken)
    idle = runner.idle
    assert idle >= 1
    control.wake()
    wait_until(lambda: runner.idle > idle)
    assert runner.taken == 0
    control.resume()
    wait_until(lambda: runner.taken == 1000)


def test_a_step_lets_one_scan_go(held):
    control, runner = held
    for count in (1, 2, 3):
        control.step(to_key_scan=False)
        wait_until(lambda count=count: runner.taken == count)
        stays(count, lambda: runner.taken)
    assert control.paused


def test_a_step_to_the_next_key_scan(held):
    control, runner = held
    for count in (1, 4, 7):
        control.step(to_key_scan=True)
        wait_until(lambda count=count: runner.taken == count)
        stays(count, lambda: runner.taken)


def test_speed_is_that_of_the_stamps():
    """30 scans, hence 2.9 s of the log, at 10 times real time; late wake-ups are made up for."""
    control = Control(10.0)
    runner = Filter(control, 30)
    began = time.perf_counter()
    runner.start()
    runner.join(10)
    assert 0.28 < time.perf_counter() - began < 2.0


def test_speed_can_be_changed_while_a_scan_is_held():
    control = Control(0.05)  # the second scan would have to wait for 2 s
    runner = Filter(control, 30)
    runner.start()
    wait_until(lambda: runner.taken == 1)
    control.set_speed(None)
    runner.join(1.5)
    assert not runner.is_alive()


def test_stamps_that_go_back_are_not_waited_for():
    control = Control(1.0)
    control.wait(10**18, lambda: None)
    began = time.perf_counter()
    control.wait(0, lambda: None)
    assert time.perf_counter() - began < 0.5


def test_the_end_holds_nothing_any_more(held):
    control, runner = held
    control.end()
    wait_until(lambda: runner.taken == 1000)
    control.pause()
    assert not control.paused


@pytest.mark.parametrize("times", [0, -1.0, 1e9, float("nan")])
def test_speeds_that_are_none(times):
    with pytest.raises(ArgumentError, match="factor"):
        check_speed(times)


def test_speeds():
    assert check_speed(None) is None
    assert check_speed(2.5) == 2.5
