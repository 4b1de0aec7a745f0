"""A log is held back, let go scan by scan, and timed; a filter that nobody holds never waits."""

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


def test_a_pause_holds_the_next_scan_and_gives_time_to_others(held):
    control, runner = held
    stays(0, lambda: runner.taken)
    idle = runner.idle
    assert idle >= 1
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


def test_speed_is_that_of_the_stamps():
    """30 scans, hence 2.9 s of the log, at 10 times real time; late wake-ups are made up for."""
    control = Control(10.0)
    runner = Filter(control, 30)
    began = time.perf_counter()
    runner.start()
    runner.join(10)
    assert 0.28 < time.perf_counter() - began < 2.0


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
