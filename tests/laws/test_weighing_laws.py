"""The kernel that weighs many poses in one field: its NumPy twin, closed forms, and what lies beyond the field."""

import numpy as np
import pytest

from gridslam.kernels import reference
from gridslam.localization.known_map import FieldTable

compiled = pytest.importorskip("gridslam.kernels._compiled")

CELL = 0.05
CORNER = np.array([-3.17, 12.4])


def packed(field):
    """Patches of a field (H, W) of numbers from 0 to 255."""
    values = field.astype(np.uint32)
    return values[:-1, :-1] | values[:-1, 1:] << 8 | values[1:, :-1] << 16 | values[1:, 1:] << 24


def case(seed, poses=40, beams=61):
    """A rough field; poses in it, at its borders and far away; some ends exactly on borders of cells."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(2, 300, 2)
    patches = packed(rng.integers(0, 256, (rows, columns)))
    side = np.array([columns, rows]) * CELL
    at = CORNER + rng.uniform(-0.2, 1.2, (poses, 2)) * side
    at[:3] = [[1e4, 0], [0, -1e6], [1e9, 1e9]]
    ends = rng.uniform(-1, 1, (beams, 2)) * rng.choice([0.3, 5.0, 20.0], (beams, 1))
    ends[:9] = np.round(ends[:9] / CELL) * CELL
    return patches, np.column_stack([at, rng.uniform(-np.pi, np.pi, poses)]), ends


@pytest.mark.parametrize("seed", range(20))
def test_twin(seed):
    patches, poses, ends = case(seed)
    sums = [k.sum_at_ends(patches, CORNER, CELL, poses, ends, 2) for k in (compiled, reference)]
    # Ends are at most 700 cells from the field's corner: single precision moves one by 3 roundings of 4e-5 cells along
    # each axis, and the field changes by at most 255 a cell. Of 61 ends at most.
    np.testing.assert_allclose(sums[0], sums[1], rtol=0, atol=61 * 255 * 2 * 3 * 4e-5)


def test_without_beams_or_poses():
    patches, poses, ends = case(0)
    for kernels in (compiled, reference):
        assert kernels.sum_at_ends(patches, CORNER, CELL, poses, ends[:0], 1).tolist() == [0.0] * len(poses)
        assert kernels.sum_at_ends(patches, CORNER, CELL, poses[:0], ends, 1).shape == (0,)


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
def test_a_plane_is_summed_exactly(kernels):
    """Bilinear interpolation is exact on a + b x + c y: the sum is that at the mean end times their number."""
    y, x = np.mgrid[:60, :50]
    patches = packed(70 + 3 * x - y)
    ends = np.random.default_rng(1).uniform(-0.8, 0.8, (37, 2))
    pose = np.array([[CORNER[0] + 25 * CELL, CORNER[1] + 30 * CELL, 0.7]])
    c, s = np.cos(0.7), np.sin(0.7)
    mean = pose[0, :2] + [[c, -s], [s, c]] @ ends.mean(axis=0)
    u, v = (mean - CORNER) / CELL - 0.5
    (total,) = kernels.sum_at_ends(patches, CORNER, CELL, pose, ends, 1)
    assert total == pytest.approx(37 * (70 + 3 * u - v), abs=37 * 2e-3)


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
def test_beyond_the_field_its_border_holds(kernels):
    field = np.full((5, 6), 7)
    field[1:-1, 1:-1] = 1
    far = np.array([[1e6, 0, 0], [-1e6, 3, 1], [0, 1e6, 2], [0.0, -1e6, -3]])
    sums = kernels.sum_at_ends(packed(field), np.zeros(2), CELL, far, np.zeros((4, 2)), 1)
    np.testing.assert_allclose(sums, 28.0, rtol=1e-5)


def test_the_number_of_threads_changes_no_bit():
    patches, poses, ends = case(3, poses=1000)
    sums = [compiled.sum_at_ends(patches, CORNER, CELL, poses, ends, threads).tobytes() for threads in (1, 2, 7)]
    assert sums[0] == sums[1] == sums[2]


def test_a_table_keeps_values_to_half_a_step():
    field = np.random.default_rng(2).normal(size=(40, 30)).astype(np.float32)
    table = FieldTable.of(field, np.zeros(2), CELL)
    rows, columns = np.mgrid[:39, :29]
    at = (np.column_stack([columns.ravel(), rows.ravel(), np.full(columns.size, -0.5)]) + 0.5) * [CELL, CELL, 0.0]
    found = table.sums(at, np.zeros((1, 2)), threads=1).reshape(rows.shape)
    step = np.ptp(field) / 255
    # Centres of cells are met to single precision, and neighbours differ by the whole range at most.
    np.testing.assert_allclose(found, field[:-1, :-1], atol=0.5 * step + np.ptp(field) * 1e-4)
    flat = FieldTable.of(np.full((3, 3), 4.5, np.float32), np.zeros(2), CELL)
    assert flat.sums(at[:2], np.zeros((3, 2)), threads=1).tolist() == [13.5, 13.5]
