"""Binary descriptors of places, in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]


def hamming_distances(a: Words, b: Words) -> NDArray[np.int32]:
    """Number of bits (N, M) by which each of `a` (N, W) differs from each of `b` (M, W), words of 64 bits."""
    different = (a[:, None, :] ^ b[None, :, :]).view(np.uint8)
    return np.asarray(np.unpackbits(different, axis=2).sum(axis=2), np.int32)
