"""The kernel that weighs many poses in one field: its NumPy twin, closed forms, and what lies beyond the field."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.kernels import reference

compiled = pytest.importorskip("gridslam.kernels._compiled")

CELL = 0.05
CORNER = np.array([-3.17, 12.4])


def case(seed, poses=40, beams=61):
    """A rough field; poses in it, at its borders and far away; some ends exactly on borders of cells."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(2, 300, 2)
    field = rng.normal(size=(rows, columns)).astype(np.float32)
    side = np.array([columns, rows]) * CELL
    at = CORNER + rng.uniform(-0.2, 1.2, (poses, 2)) * side
    at[:3] = [[1e4, 0], [0, -1e6], [1e9, 1e9]]
    ends = rng.uniform(-1, 1, (beams, 2)) * rng.choice([0.3, 5.0, 20.0], (beams, 1))
    ends[:9] = np.round(ends[:9] / CELL) * CELL
    return field, np.column_stack([at, rng.uniform(-np.pi, np.pi, poses)]), ends


@pytest.mark.parametrize("seed", range(20))
def test_twin(seed):
    field, poses, ends = case(seed)
    sums = [k.sum_at_ends(field, CORNER, CELL, poses, ends, 2) for k in (compiled, reference)]
    # Ends are at most 600 cells from the field's corner: single precision moves one by 3 roundings of 4e-5 cells along
    # each axis, and the field changes by at most the range of its values, 10, per cell. Of 61 ends at most.
    np.testing.assert_allclose(sums[0], sums[1], rtol=0, atol=61 * 10 * 2 * 3 * 4e-5)


def test_without_beams_or_poses():
    field, poses, ends = case(0)
    for kernels in (compiled, reference):
        assert kernels.sum_at_ends(field, CORNER, CELL, poses, ends[:0], 1).tolist() == [0.0] * len(poses)
        assert kernels.sum_at_ends(field, CORNER, CELL, poses[:0], ends, 1).shape == (0,)


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
def test_a_plane_is_summed_exactly(kernels):
    """Bilinear interpolation is exact on a + b x + c y: the sum is that at the mean end times their number."""
    y, x = np.mgrid[:200, :150]
    field = (3 + 0.5 * x - 0.25 * y).astype(np.float32)  # exact in single precision
    ends = np.random.default_rng(1).uniform(-1, 1, (37, 2))
    pose = np.array([[CORNER[0] + 75 * CELL, CORNER[1] + 100 * CELL, 0.7]])
    c, s = np.cos(0.7), np.sin(0.7)
    mean = pose[0, :2] + [[c, -s], [s, c]] @ ends.mean(axis=0)
    u, v = (mean - CORNER) / CELL - 0.5
    (total,) = kernels.sum_at_ends(field, CORNER, CELL, pose, ends, 1)
    assert total == pytest.approx(37 * (3 + 0.5 * u - 0.25 * v), abs=37 * 1e-3)


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
def test_beyond_the_field_its_border_holds(kernels):
    field = np.full((5, 6), 7.0, np.float32)
    field[1:-1, 1:-1] = 1.0
    far = np.array([[1e6, 0, 0], [-1e6, 3, 1], [0, 1e6, 2], [0.0, -1e6, -3]])
    assert kernels.sum_at_ends(field, np.zeros(2), CELL, far, np.zeros((4, 2)), 1).tolist() == [28.0] * 4


def test_the_number_of_threads_changes_no_bit():
    field, poses, ends = case(3, poses=1000)
    sums = [compiled.sum_at_ends(field, CORNER, CELL, poses, ends, threads).tobytes() for threads in (1, 2, 7)]
    assert sums[0] == sums[1] == sums[2]
