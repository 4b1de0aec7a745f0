"""The pyramid holds the maxima, and the search finds what trying every pose of the lattice finds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.kernels import reference
from gridslam.localization.known_map import FieldTable

compiled = pytest.importorskip("gridslam.kernels._compiled")

BOTH = pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
ANYWHERE = np.zeros((3, 3)), 1.0
QUICK = settings(max_examples=60)


def square(likelihood, y, x, side):
    """The greatest value of the square that begins at (y, x); 0 outside."""
    inside = likelihood[max(y, 0) : max(y + side, 0), max(x, 0) : max(x + side, 0)]
    return int(inside.max()) if inside.size else 0


def pyramid_of(kernels, likelihood):
    """That of a map of such likelihoods (H, W), in whole tiles."""
    whole = np.pad(likelihood, [(0, -side % 32) for side in likelihood.shape])
    tiles = whole.reshape(whole.shape[0] // 32, 32, whole.shape[1] // 32, 32).swapaxes(1, 2)
    ids = np.arange(1, 1 + tiles.shape[0] * tiles.shape[1], dtype=np.int32).reshape(tiles.shape[:2])
    field = np.concatenate([np.zeros((1, 32, 32), np.uint8), tiles.reshape(-1, 32, 32)])
    return kernels.max_pyramid(field, ids, np.arange(256, dtype=np.uint8))


@BOTH
@pytest.mark.parametrize("shape", [(1, 1), (7, 3), (16, 33), (1, 90)])
def test_the_pyramid_holds_the_maxima(kernels, shape):
    likelihood = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    likelihood[likelihood < 200] //= 4
    cells, nodes, top = pyramid_of(kernels, likelihood)
    rows, cols = (side + -side % 32 + 32 for side in shape)
    assert cells.shape == nodes.shape == (rows, cols)
    for y in range(-16, rows - 16):
        for x in range(-16, cols - 16):
            framed = y + 16, x + 16
            assert cells[framed] == square(likelihood, y, x, 1)
            assert nodes[framed] == square(likelihood, y, x, 8)
            at = framed[0] % 16, framed[1] % 16, framed[0] // 16, 32 + framed[1] // 16
            assert top[at] == square(likelihood, y, x, 16)
    assert not top[:, :, -1].any()
    assert not top[..., :32].any()
    assert top.shape == (16, 16, rows // 16 + 1, 32 + cols // 16)


@BOTH
def test_likelihoods_come_from_the_tiles_by_the_table(kernels):
    rng = np.random.default_rng(2)
    field = rng.integers(0, 256, (4, 32, 32), dtype=np.uint8)
    table = rng.integers(0, 256, 256, dtype=np.uint8)
    cells, *_ = kernels.max_pyramid(field, np.array([[2, 0, 2], [3, 1, 0]], np.int32), table)
    expected = table[np.block([[field[2], field[0], field[2]], [field[3], field[1], field[0]]])]
    np.testing.assert_array_equal(cells[16:-16, 16:-16], expected)


def exhaustive(likelihood, ends, headings, window, centre, information, distance, places, floor, rival, apart):
    """Every pose of the lattice, one by one, in plain Python."""
    (x0, x1, y0, y1), (height, width) = window, likelihood.shape
    scored = []
    for a, heading in enumerate(headings):
        c, s = math.cos(heading), math.sin(heading)
        cells = [(math.floor(s * u + c * v + 0.5), math.floor(c * u - s * v + 0.5)) for u, v in ends.tolist()]
        for y in range(y0, y1):
            for x in range(x0, x1):
                d = np.array([x + 0.5, y + 0.5, heading]) - centre
                if d @ information @ d > distance**2:
                    continue
                seen = [(y + dy, x + dx) for dy, dx in cells]
                total = sum(int(likelihood[v, u]) for v, u in seen if 0 <= v < height and 0 <= u < width)
                if total >= floor:
                    scored.append((total, a, y, x))
    scored.sort(key=lambda pose: (-pose[0], *pose[1:]))
    found = []
    for pose in scored:
        if len(found) == places or (found and pose[0] < rival * found[0][0]):
            break
        if all(differs(pose, place, headings, *apart) for place in found):
            found.append(pose)
    return found


def differs(pose, place, headings, cells, rad):
    turn = (headings[pose[1]] - headings[place[1]] + math.pi) % (2 * math.pi) - math.pi
    return abs(turn) > rad or math.hypot(pose[2] - place[2], pose[3] - place[3]) > cells


@st.composite
def searches(draw):
    """A small map of few values, so that sums tie, and a window that may stick out of it or miss it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    height, width = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    likelihood = rng.choice(np.array([0, 0, 1, 2, 255], np.uint8), (height, width))
    ends = rng.uniform(-12, 12, (draw(st.integers(1, 7)), 2))
    if draw(st.booleans()):
        ends = np.round(ends) + 0.5  # on borders of cells
    x0, y0 = draw(st.integers(-20, 20)), draw(st.integers(-20, 20))
    window = x0, x0 + draw(st.integers(1, 19)), y0, y0 + draw(st.integers(1, 19))
    first, step, count = draw(st.sampled_from([0.0, 3.0])), draw(st.sampled_from([0.1, 1.6])), draw(st.integers(1, 4))
    headings = first + step * np.arange(count)
    centre = np.array([x0 + 6.3, y0 + 4.8, headings.mean()])
    root = rng.normal(size=(3, 3)) * draw(st.sampled_from([0.0, 0.05, 0.5]))
    gate = centre, root @ root.T, draw(st.sampled_from([0.5, 1.0, 3.0]))
    wanted = draw(st.integers(1, 4)), draw(st.sampled_from([0, 1, 200, 500])), draw(st.sampled_from([0.0, 0.6, 1.0]))
    apart = draw(st.sampled_from([0.5, 3.0, 7.5])), draw(st.sampled_from([0.05, 0.35, 4.0]))
    return likelihood, ends, headings, window, *gate, *wanted, apart


@given(searches())
@QUICK
def test_the_search_equals_trying_every_pose(search):
    likelihood, ends, headings, window, *gate, places, floor, rival, apart = search
    expected = exhaustive(likelihood, ends, headings, window, *gate, places, floor, rival, apart)
    for kernels in (compiled, reference):
        pyramid = pyramid_of(kernels, likelihood)
        found = kernels.correlate(*pyramid, ends, headings, window, *gate, places, floor, rival, *apart)
        assert found.dtype == np.int32
        assert [tuple(place) for place in found.tolist()] == expected


def walls(rng, size=220):
    """Likelihoods of random walls, falling off as those of a map do."""
    occupied = np.zeros((size, size), bool)
    for _ in range(14):
        y, x, length = rng.integers([0, 0, 20], [size, size, 120]).tolist()
        occupied[(y, slice(x, x + length)) if rng.random() < 0.5 else (slice(y, y + length), x)] = True
    y, x = np.nonzero(occupied)
    likelihood = np.zeros((size, size), np.uint8)
    for dy, dx in np.ndindex(13, 13):
        v, u = y + dy - 6, x + dx - 6
        inside = (v >= 0) & (u >= 0) & (v < size) & (u < size)
        weight = np.uint8(255 / (1 + ((dy - 6) ** 2 + (dx - 6) ** 2) / 4))
        np.maximum.at(likelihood, (v[inside], u[inside]), weight)
    return likelihood, np.column_stack([x, y]) + 0.5


@pytest.mark.parametrize("gated", [False, True], ids=["box", "ellipse"])
@pytest.mark.parametrize("seed", range(6))
def test_both_agree_on_walls(seed, gated):
    """Windows of many strips and rows, up to 256 points, several places; the first is where the points were seen."""
    rng = np.random.default_rng(seed)
    likelihood, points = walls(rng)
    truth = np.array([*(rng.integers(60, 160, 2) + 0.5), rng.uniform(-3, 3)])
    c, s = math.cos(truth[2]), math.sin(truth[2])
    seen = points[rng.choice(len(points), 256)] - truth[:2]
    ends = np.column_stack([c * seen[:, 0] + s * seen[:, 1], c * seen[:, 1] - s * seen[:, 0]])
    x, y = (int(v) for v in truth[:2] + rng.integers(-20, 20, 2))
    window = x - 75, x + 71, y - 40, y + 53
    headings = truth[2] + 0.02 * np.arange(-9, 4)
    spread = np.array([[900, 880, 0.5], [880, 900, 0.2], [0.5, 0.2, 0.01]])
    gate = truth + np.array([4.0, -3.0, 0.05]), np.linalg.inv(spread), 2.0
    if not gated:
        gate = truth, *ANYWHERE
    pyramid = pyramid_of(compiled, likelihood)
    args = *pyramid, ends, headings, window, *gate, 4, 40 * 256, 0.3, 12.0, 0.1
    found = compiled.correlate(*args)
    np.testing.assert_array_equal(found, reference.correlate(*args))
    # Ends are cells' centres, here turned back and forth: a border is half a cell away, so each is in its own cell
    assert found[0].tolist() == [255 * 256, 9, int(truth[1]), int(truth[0])]
    assert len(found) > 1


@BOTH
def test_nothing_is_found_below_the_floor_or_without_places(kernels):
    pyramid = pyramid_of(kernels, np.full((20, 20), 100, np.uint8))
    for places, floor, expected in ((1, 201, 0), (1, 200, 1), (0, 0, 0)):
        window, headings = (5, 9, 5, 9), np.zeros(1)
        found = kernels.correlate(
            *pyramid, np.zeros((2, 2)), headings, window, np.zeros(3), *ANYWHERE, places, floor, 0.0, 1.0, 0.1
        )
        assert found.shape == (expected, 4)


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
