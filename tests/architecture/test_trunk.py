"""The trunk fits on one screen."""

import inspect

from gridslam.slam import GridFastSlam

SCREEN_LINES = 40


def test_the_trunk_fits_on_one_screen():
    assert len(inspect.getsource(GridFastSlam.step).splitlines()) <= SCREEN_LINES
