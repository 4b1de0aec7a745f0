"""Angles: worked values and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.geometry.angles import find_wrong_beam_angles, wrap

TURN = 2 * math.pi


@pytest.mark.parametrize(
    ("angle", "want"),
    [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (TURN, 0.0), (4.0, 4.0 - TURN), (7, 7 - TURN)],
)
def test_wrap_of_known_angles(angle: float, want: float) -> None:
    assert wrap(angle) == want
    assert wrap(np.array([angle]))[0] == want


@pytest.mark.parametrize("most", [np.pi, 3 * np.pi, 100.0])
def test_many_angles_are_wrapped_as_each_by_itself(most: float) -> None:
    """Bit for bit, whichever way is taken; with angles at the ends of the interval, and next to them."""
    ends = np.array([k * np.pi for k in range(-4, 5)])
    ends = np.concatenate([ends, np.nextafter(ends, -9), np.nextafter(ends, 9)])
    angles = np.concatenate([np.random.default_rng(0).uniform(-most, most, 1000), ends[np.abs(ends) < most]])
    assert wrap(angles).tolist() == [wrap(angle) for angle in angles.tolist()]


@pytest.mark.parametrize(
    ("start", "step", "beams", "end"),
    [
        (-math.pi, TURN / 360, 360, math.nan),  # nothing stated
        (-math.pi, TURN / 360, 360, math.pi),  # the beam that would follow the last one
        (-math.pi, TURN / 359, 360, math.pi),
        (-math.pi, TURN / 360, 361, math.pi),
        (0.0, TURN / 360, 360, 0.0),  # left at 0
        (math.pi / 2, TURN / 360, 360, math.pi / 2 - TURN / 360),  # a whole turn away
        (2.5, 0.01, 200, 2.5 + 1.99 - TURN),  # across the cut at pi
        (math.pi, -TURN / 720, 720, -math.pi),  # clockwise
        (-2.0, 0.0175, 230, 2.0),  # rounded to a few digits
        (0.0, 0.0, 1, 0.0),
        (0.0, 0.1, 0, 0.0),
    ],
)
def test_the_angles_of_drivers_that_are_used_are_right(start, step, beams, end):
    assert find_wrong_beam_angles(start, step, beams, end) == ""


@pytest.mark.parametrize(
    ("start", "step", "beams", "end", "problem"),
    [
        (-math.pi, math.pi / 360, 360, math.pi, "not at angle_max 3.14159"),
        (-math.pi, 4 * math.pi / 360, 360, math.pi, "not at angle_max 3.14159"),
        (-math.pi, -TURN / 360, 360, math.pi, "not at angle_max 3.14159"),  # turned the other way
        (-math.pi, TURN / 360, 360, 180.0, "look like degrees"),
        (-180.0, TURN / 360, 360, 180.0, "look like degrees"),
        (-180.0, 1.0, 360, 179.0, "more than one turn: the angles look like degrees"),
        (-180.0, 0.01, 360, math.nan, "look like degrees"),
        (0.0, 2 * TURN / 360, 360, math.nan, "more than one turn"),
        (0.0, 0.0, 360, 3.0, "all point one way"),
        (math.nan, 0.1, 360, 3.0, "expected finite angles"),
    ],
)
def test_angles_that_no_laser_has_are_described_by_their_numbers(start, step, beams, end, problem):
    assert problem in find_wrong_beam_angles(start, step, beams, end)


@pytest.mark.parametrize("factor", [2, 3])
def test_a_step_that_is_a_few_times_too_long_is_not_called_degrees(factor):
    assert find_wrong_beam_angles(0.0, factor * TURN / 360, 360, factor * TURN).endswith("more than one turn")


@pytest.mark.parametrize(("start", "step"), [(-28.5, 0.5), (-90.0, 1.0), (0.0, 0.5), (-135.0, 0.25)])
def test_degrees_of_any_field_of_view_are_called_so(start, step):
    beams = round(max(2 * abs(start), 57) / step) + 1
    assert "look like degrees" in find_wrong_beam_angles(start, step, beams, start + step * (beams - 1))
