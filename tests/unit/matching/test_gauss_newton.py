"""Gauss-Newton on the distance field: finds displacements, says what it knows, and what it does not."""

from dataclasses import replace

import checks
import numpy as np
import pytest

from gridslam.grid import Evidence, TileMaps
from gridslam.matching import GaussNewton
from gridslam.matching.gauss_newton import (
    degenerate_direction,
    judged_inlier_ratio,
    known_inlier_ratio,
)
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.05
ROW = np.zeros(1, np.int32)
GEOMETRY = ScanGeometry(np.deg2rad(np.arange(360) - 179.5))
ROOM = np.array([3.02, 2.02])
"""Half the sides of the room, m: the walls lie near the middle of a row or column of cells."""


def scan_of_room(pose, half=ROOM, noise=None, max_m=30.0):
    """What a laser at `pose` sees of an empty rectangle |x| <= half[0], |y| <= half[1]."""
    angles = GEOMETRY.bearings + pose[2]
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges = ((half * np.sign(directions) - pose[:2]) / directions).min(axis=1)
    if noise is not None:
        ranges = ranges + noise
    return LaserScan.from_ranges(0, ranges, GEOMETRY, range_max_m=max_m).beams(0.05, max_m)


def map_of_room(half=ROOM, max_m=30.0, places=((0.0, 0.0, 0.0), (0.4, -0.3, 0.5), (-0.5, 0.6, 2.0))):
    """The room as mapped from known poses."""
    maps = TileMaps(1, resolution_m=CELL, reach_cells=10.5, evidence=Evidence(2.4, -0.4, -16, 32, 2.0))
    for place in places:
        maps.update(ROW, np.array([place]), scan_of_room(np.array(place), half, max_m=max_m))
    return maps


def prior(position=0.0, heading=0.0):
    return np.diag([position, position, heading])[None]


@pytest.fixture(scope="module")
def room():
    return map_of_room()


@pytest.mark.parametrize("seed", range(8))
def test_a_known_displacement_is_found(room, seed):
    """From up to 15 cm and 3 degrees away; the map's cells are 5 cm, so a fifth of a cell is asked for."""

    def match(truth, guess):
        found = GaussNewton()(room, ROW, guess[None], prior(), scan_of_room(truth))
        assert found.score[0] > 0.95 * 360
        return found.poses[0]

    checks.displacement_is_found(match, seed)


def test_the_information_is_that_of_the_walls(room):
    """Symmetric and positive; each beam informs by one across its wall: a metre moved is a metre of residual.

    From the centre of the room beams of angles up to atan(h_y / h_x) hit the walls x = +-h_x: a share of
    2 atan(h_y / h_x) / pi = 0.375 of 360 beams tells x, the rest tells y; cross terms vanish by symmetry. The field is
    interpolated between whole cells, so its slope across a straight wall is 1 where the wall is one cell thick; ends
    on the wall's own row of cells lie between slopes of +1 and -1.
    """
    match = GaussNewton()(room, ROW, np.zeros((1, 3)), prior(), scan_of_room(np.zeros(3)))
    information, score = match.information[0], match.score[0]
    np.testing.assert_allclose(information, information.T)
    assert (np.linalg.eigvalsh(information) > 0).all()
    assert 0 < information[0, 0] <= 0.375 * 360 * 1.1
    assert 0 < information[1, 1] <= 0.625 * 360 * 1.1
    assert abs(information[0, 1]) < 0.1 * min(information[0, 0], information[1, 1])
    assert 0 < score <= 360


def test_the_information_predicts_the_spread_of_matches(room):
    """Over 200 scans with noise of 2 cm the covariance of the matches is that of the information, within a factor of 3.

    The residuals' variance is (0.02 m)^2, so the covariance is about 0.02^2 inv(H), H of residuals in metres. It is no
    closed form: the slope of the field is 1 on either side of a wall but 0 at its ridge, and beams are weighted.
    """
    rng = np.random.default_rng(4)
    truth = np.array([0.2, 0.1, 0.3])
    found, informations = [], []
    for _ in range(200):
        match = GaussNewton()(room, ROW, truth[None], prior(), scan_of_room(truth, noise=rng.normal(0, 0.02, 360)))
        found.append(match.poses[0])
        informations.append(match.information[0])
    predicted = 0.02**2 * np.linalg.inv(np.mean(informations, axis=0))
    spread = np.cov(np.array(found).T)
    ratio = np.diag(spread) / np.diag(predicted)
    assert (ratio > 1 / 3).all()
    assert (ratio < 3).all()


CORRIDOR = np.array([50.0, 1.02])


@pytest.fixture(scope="module")
def corridor():
    """Mapped while driving along it, so that its walls have no gaps to hold on to."""
    return map_of_room(CORRIDOR, max_m=4.0, places=[(0.07 * i, 0.0, 0.0) for i in range(-100, 101)])


def test_a_corridor_keeps_the_guess_along_its_axis_and_says_so(corridor):
    """Two parallel walls and no end: across and heading are found, along the corridor nothing is known."""
    truth = np.array([0.0, 0.05, 0.02])
    guess = truth + np.array([0.13, 0.08, 0.03])
    match = GaussNewton()(corridor, ROW, guess[None], prior(), scan_of_room(truth, CORRIDOR, max_m=4.0))
    assert match.poses[0, 1] == pytest.approx(truth[1], abs=0.01)
    assert match.poses[0, 2] == pytest.approx(truth[2], abs=0.003)
    assert match.poses[0, 0] == pytest.approx(guess[0], abs=0.003)
    axis = degenerate_direction(match.information[0], float(match.score[0]))
    assert axis is not None
    assert abs(axis[0]) > 0.999
    assert np.linalg.norm(axis) == pytest.approx(1.0)


def test_a_direction_in_which_the_guess_was_kept_is_undetermined(corridor):
    """A beam of 360 on a post shows where along the axis: less than one in 200, so the match does not use it."""
    corridor = corridor.snapshot()
    beams = scan_of_room(np.zeros(3), CORRIDOR, max_m=4.0)
    ends = beams.ends.copy()
    ends[0] = [3.0, 0.02]
    seen = replace(beams, ends=ends)
    for _ in range(10):  # until the post outweighs the passages of the drive
        corridor.update(ROW, np.zeros((1, 3)), seen)
    guess = np.array([[0.1, 0.0, 0.0]])
    match = GaussNewton()(corridor, ROW, guess, prior(), seen)
    assert match.information[0, 0, 0] > 0
    assert match.poses[0, 0] == pytest.approx(0.1, abs=0.001)
    axis = degenerate_direction(match.information[0], float(match.score[0]))
    assert axis is not None
    assert abs(axis[0]) > 0.99
    free = GaussNewton(min_information=0.0)(corridor, ROW, guess, prior(), seen)
    assert free.poses[0, 0] == pytest.approx(0.0, abs=0.04)
    assert degenerate_direction(free.information[0], float(free.score[0]), 0.0) is None


def map_of_nothing():
    return TileMaps(1, resolution_m=CELL, reach_cells=10.5, evidence=Evidence(2.4, -0.4, -16, 32, 2.0))


def half_seen(pose, half):
    """What a laser that looks ahead, 180 degrees, sees of an empty rectangle."""
    beams = scan_of_room(pose, np.array(half))
    ahead = np.abs(GEOMETRY.bearings[beams.indices]) < np.pi / 2
    return replace(beams, indices=beams.indices[ahead], ends=beams.ends[ahead])


@pytest.mark.parametrize("half", [(1.62, 1.22), (3.22, 1.22), (4.02, 1.22)])
def test_a_wall_goes_on_where_it_is_not_mapped_yet(half):
    """A robot turns on the spot, and sees more of the wall that was beside it.

    The mapped part's end is the nearest obstacle to all that is new of it, and would draw the robot forward, and hold
    it back in turning.
    """
    maps, truth = map_of_nothing(), [0.0, 0.0, -0.2]
    maps.update(ROW, np.zeros((1, 3)), half_seen(np.zeros(3), half))
    drawn, free = (
        GaussNewton(point_to_line=lines)(maps, ROW, np.array([truth]), prior(), half_seen(np.array(truth), half)).poses[
            0
        ]
        - truth
        for lines in (False, True)
    )
    assert drawn[0] > 0.01
    assert np.abs(free).max() < 0.0075
    assert free[0] < 0.6 * drawn[0]


def test_beams_that_end_where_nothing_is_mapped_count_only_where_they_pass_through_a_wall():
    """A robot that looks ahead turns on the spot, and sees more of the wall; it is not half a metre farther."""
    maps, half = map_of_nothing(), (2.22, 1.62)
    maps.update(ROW, np.zeros((1, 3)), half_seen(np.zeros(3), half))

    def ratios(seen_from, said_to_be_at):
        beams, at = half_seen(np.array(seen_from), half), np.array(said_to_be_at)
        return known_inlier_ratio(maps, ROW, at, beams.ends, 0.1), judged_inlier_ratio(maps, ROW, at, beams, 0.1)

    turned = [0.0, 0.0, -0.6]
    assert min(ratios(turned, turned)) > 0.95
    known, judged = ratios([0.0, 0.0, 0.0], [0.5, 0.0, 0.0])
    assert known > 0.9
    assert judged < 0.65


def test_successive_ends_in_one_square_count_once():
    maps, beams = map_of_room(), scan_of_room(np.zeros(3))
    guess, prior = (0.02, -0.01, 0.005), (1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9)
    whole = GaussNewton().match_pose(maps, 0, guess, prior, beams)
    thinned = GaussNewton().match_pose(maps, 0, guess, prior, beams, thin_m=0.1)
    squares = np.floor(beams.ends / 0.1)
    distinct = 1 + np.count_nonzero((squares[1:] != squares[:-1]).any(axis=1))
    assert distinct < 0.6 * len(beams)
    assert 0.9 * distinct < thinned.score <= distinct
    assert thinned.agreeing == pytest.approx(whole.agreeing, rel=0.01)
    assert whole.agreeing == whole.score
    np.testing.assert_allclose(thinned.pose, np.zeros(3), rtol=0, atol=0.005)
