"""Distances of binary descriptors: bits counted one by one."""

import numpy as np
import pytest

from gridslam.kernels import reference

compiled = pytest.importorskip("gridslam.kernels._compiled")


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
@pytest.mark.parametrize(("n", "m", "words"), [(7, 5, 4), (1, 9, 1), (0, 3, 4), (3, 0, 4)])
def test_distances_count_the_bits_that_differ(kernels, n, m, words):
    rng = np.random.default_rng(n)
    a, b = (rng.integers(0, 2**64, (rows, words), dtype=np.uint64) for rows in (n, m))
    counted = [[sum((x ^ y).bit_count() for x, y in zip(r, s, strict=True)) for s in b.tolist()] for r in a.tolist()]
    found = kernels.hamming_distances(a, b)
    assert found.dtype == np.int32
    assert found.tolist() == counted
