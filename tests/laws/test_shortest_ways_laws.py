"""The least uncertain ways over a graph of submaps: the kernel finds those of its twin, and these are the least."""

from itertools import pairwise

import numpy as np
import pytest

from gridslam.kernels import reference
from gridslam.slam.loop_closure.rows import Rows

compiled = pytest.importorskip("gridslam.kernels._compiled")


def random_graph(rng, submaps=40, links=30):
    """A walk with links between its submaps, some pairs twice; moments are those of positions alone."""
    firsts = np.column_stack([rng.uniform(-20, 20, (submaps, 2)), rng.uniform(-np.pi, np.pi, submaps)])
    ends = rng.integers(0, submaps, (links, 2))
    ends = ends[ends[:, 0] != ends[:, 1]].astype(np.int32)
    steps = np.zeros((submaps - 1, 9))
    steps[:, 0] = steps[:, 2] = rng.uniform(0.1, 1.0, submaps - 1)
    values = np.zeros((len(ends), 12))
    values[:, :3] = rng.normal(size=(len(ends), 3))
    values[:, 3] = values[:, 5] = rng.uniform(0.05, 0.5, len(ends))
    return firsts, steps, ends, values


def least_variances(steps, ends, values, begin, limit):
    """Of the position at each submap, by relaxing all edges again and again."""
    cost = np.full(len(steps) + 1, np.inf)
    cost[begin] = 0.0
    edges = [(a, b, 2 * v) for (a, b), v in zip(ends.tolist(), values[:, 3].tolist(), strict=True)]
    edges += [e for (a, b), v in zip(pairwise(range(len(cost))), steps[:, 0].tolist(), strict=True)
              for e in ((a, b, 2 * v), (b, a, 2 * v))]  # fmt: skip
    for _ in cost:
        for a, b, v in edges:
            if cost[a] + v < min(cost[b], limit):
                cost[b] = cost[a] + v
    return cost


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
@pytest.mark.parametrize("seed", range(8))
def test_ways_are_the_least_uncertain(seed, kernels):
    rng = np.random.default_rng(seed)
    firsts, steps, ends, values = random_graph(rng)
    begin = int(rng.integers(len(firsts)))
    found, moments, _ = kernels.shortest_ways(
        firsts, steps, ends, values, begin, np.zeros(9), firsts[begin], 1.0, 2.0, 4.0, 100, -1
    )
    expected = least_variances(steps, ends, values, begin, 4.0)
    assert set(found.tolist()) == set(np.flatnonzero(np.isfinite(expected)).tolist())
    assert 5 < len(found) <= len(firsts)
    np.testing.assert_allclose(moments[:, 0] + moments[:, 2], expected[found], atol=1e-12)
    assert (np.diff(expected[found]) >= -1e-12).all()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(("most", "last"), [(100, -1), (7, -1), (100, 3)])
def test_the_kernel_finds_what_its_twin_finds(seed, most, last):
    """In the same order, headings' moments included, and to the last bits of sine and cosine where the key scan is."""
    rng = np.random.default_rng(seed)
    firsts, steps, ends, values = random_graph(rng)
    for moments in (steps, values[:, 3:]):
        headings = rng.uniform(0, 0.01, len(moments))
        places = rng.uniform(-20, 20, (len(moments), 2))
        moments[:, 3] = headings
        moments[:, 4:6] = headings[:, None] * places
        moments[:, 6:] = headings[:, None] * places[:, [0, 0, 1]] * places[:, [0, 1, 1]]
    begin = int(rng.integers(len(firsts)))
    start = (begin, rng.uniform(0, 1e-3, 9), rng.normal(size=3), *rng.uniform(-20, 20, 2).tolist(), 9.0, most, last)
    one, other = (kernels.shortest_ways(firsts, steps, ends, values, *start) for kernels in (compiled, reference))
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_array_equal(one[1], other[1])
    np.testing.assert_allclose(one[2], other[2], rtol=0, atol=1e-12)
    assert len(one[0]) <= most
    assert last < 0 or last not in one[0][:-1]


def test_rows_grow_as_one_array():
    rows = Rows(2, np.int32)
    expected = [(k, -k) for k in range(100)]
    for row in expected:
        rows.append(row)
    twin = rows.copy()
    rows.array[0] = 7
    np.testing.assert_array_equal(twin.array, expected)
    assert rows.array[0].tolist() == [7, 7]
    rows.clear()
    assert len(rows) == 0
    assert rows.array.shape == (0, 2)
    assert len(twin) == 100
