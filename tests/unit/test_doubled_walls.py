"""Walls of a corridor are single, and doubled where its second visit was mapped beside the first."""

from __future__ import annotations

from itertools import islice, pairwise

import numpy as np
import pytest

from gridslam import CarmenLog
from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching import GaussNewton
from gridslam.types import OccupancyGrid
from support.doubled_walls import Walls, judge_walls

CELL_M, WIDE_M = 0.05, 1.0


class Drawing:
    """A map of 40 m x 24 m about (0, 0) to draw in."""

    def __init__(self) -> None:
        self.log_odds, self.known = np.zeros((480, 800), np.float32), np.zeros((480, 800), bool)

    def fill(self, x0: float, y0: float, x1: float, y1: float, log_odds: float) -> None:
        (c0, r0), (c1, r1) = (np.rint(np.add(p, (20, 12)) / CELL_M).astype(int) for p in ((x0, y0), (x1, y1)))
        self.log_odds[r0:r1, c0:c1], self.known[r0:r1, c0:c1] = log_odds, True

    def corridor(self, x0: float, x1: float, y: float, askew: float = 0.0) -> None:
        """2 m wide; one that is mapped later frees what it drives through, and leaves the walls that it does not."""
        for x in np.arange(x0, x1, 0.25):
            middle = y + askew * (x - x0)
            before = self.log_odds.copy()
            self.fill(x, middle - WIDE_M, x + 0.25, middle + WIDE_M, -2.0)
            self.log_odds = np.where(before > 0, before, self.log_odds)
            for wall in (middle - WIDE_M, middle + WIDE_M):
                self.fill(x, wall, x + 0.25, wall + CELL_M, 3.0)

    @property
    def grid(self) -> OccupancyGrid:
        return OccupancyGrid(self.log_odds, self.known, CELL_M, np.array([-20.0, -12.0]))


def around(beside: float, returns: bool = True) -> np.ndarray:
    """West along the corridor, around a block south of it, and back into it from the east, `beside` its middle."""
    corners = [(0, 0), (-6, 0), (-6, -9), (12, -9), *([(12, beside), (4, beside)] if returns else [])]
    legs = [np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(corners)]
    points = np.concatenate(legs)
    return np.column_stack([points, np.zeros(len(points))])


@pytest.mark.parametrize(
    ("beside", "walls"),
    [
        (0.0, Walls.SINGLE),
        (0.1, Walls.SINGLE),
        (0.4, Walls.DOUBLED),
        (0.7, Walls.DOUBLED),
        (-1.0, Walls.DOUBLED),
        (2.1, Walls.DOUBLED),
    ],
)
@pytest.mark.parametrize("askew", [0.0, 0.03])
def test_a_second_visit_beside_the_first_doubles_the_walls(beside, walls, askew):
    drawing = Drawing()
    drawing.corridor(-10, 9, 0.0)
    drawing.corridor(-2, 12, beside, askew if beside > 0.1 else 0.0)
    found = judge_walls(drawing.grid, around(beside))
    assert found.walls is walls
    assert (found.doubled_m > 4) == (walls is Walls.DOUBLED)
    if walls is Walls.DOUBLED:
        assert found.apart_m == pytest.approx(abs(beside), abs=0.35)


def test_a_real_corridor_drawn_once_and_drawn_twice(data_dir):
    """The first corridor of DP-SLAM's loop, each scan matched to those before it, and once more a little beside."""
    scans = list(islice(CarmenLog(data_dir / "loops" / "dpslam_loop5.clf.gz"), 40, 75))
    maps, row, loose = OccupancyGridMapping().empty(1), np.zeros(1, np.int32), 1e-3 * np.eye(3)[None]
    odometry = np.array([o.pose for o, _ in scans])
    poses = [odometry[0]]
    for step, (_, scan) in zip([np.zeros(3), *between(odometry[:-1], odometry[1:])], scans, strict=True):
        guess, beams = compose(poses[-1], step)[None], scan.beams(0.05, 30.0)
        poses.append(GaussNewton()(maps, row, guess, loose, beams).poses[0] if len(poses) > 1 else guess[0])
        maps.update(row, poses[-1][None], beams)
    placed = np.array(poses[1:])
    across = placed[-1, 2] + np.pi / 2

    def walls(beside_m: float) -> Walls:
        moved = np.add(placed, (beside_m * np.cos(across), beside_m * np.sin(across), 0.0))
        drawn = OccupancyGridMapping().empty(1)
        for pose, (_, scan) in zip([*placed, *moved], [*scans, *scans], strict=True):
            drawn.update(row, pose[None], scan.beams(0.05, 30.0))
        elsewhere = compose(placed[-1], [15.0, 15.0, 0.0])[None]
        return judge_walls(drawn.occupancy(0), np.concatenate([placed, elsewhere, moved[::-1]])).walls

    assert walls(0.0) is Walls.SINGLE
    assert walls(0.6) is Walls.DOUBLED
    assert walls(-0.9) is Walls.DOUBLED
