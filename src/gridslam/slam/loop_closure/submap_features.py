"""Keypoints and binary descriptors of a submap, seen from above, at any heading."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.types import FloatArray, IntArray

_CELL_M = 0.2
"""Cells of the image: coarse enough that drift within a submap and moved chairs change few of them."""
_MIN_HITS = 2
_MOST_KEYPOINTS = 400
_PATCH = 15
"""Radius of a descriptor's patch, in cells: 3 m."""
_BORDER = _PATCH + 8
_BITS = 256
_HARRIS = 0.05
_LEAST_CORNER = 1e-8
_MOST_DIFFERENT_BITS = 70
"""Descriptors of different places differ by 128 bits on average, with a standard deviation of 8 if bits were free."""
_MOST_MATCHES = 120
_MOST_ALIKE_BITS = 90
_MOST_NEAREST = 300
"""Of matches with several keypoints each, more different ones and more of them are worth a look."""

_DISC_Y, _DISC_X = np.nonzero(np.hypot(*np.mgrid[-_PATCH : _PATCH + 1, -_PATCH : _PATCH + 1]) <= _PATCH)
_DISC_Y -= _PATCH
_DISC_X -= _PATCH


def _spiral(order: IntArray) -> FloatArray:
    """Cells x, y (2, K) on a spiral by the golden angle, denser towards the middle, in some order (K,)."""
    radius = (_PATCH - 2) * (order + 0.5) / _BITS
    angle = order * math.pi * (3 - math.sqrt(5))
    return np.asarray(np.rint(radius * np.stack([np.cos(angle), np.sin(angle)])))


_COMPARED = np.concatenate([_spiral(np.arange(_BITS)), _spiral((97 * np.arange(_BITS) + 31) % _BITS)])
"""Cells x1, y1, x2, y2 of which each bit compares the brightness, about an upright keypoint."""


@final
class SubmapFeatures(NamedTuple):
    """Keypoints of a submap.

    Attributes
    ----------
    points : (K, 2) float64, m
        In the submap's frame.
    headings : (K,) float64, rad
        Direction from each towards the centre of what is occupied about it.
    descriptors : (K, 4) uint64
        256 bits each.
    """

    points: FloatArray
    headings: FloatArray
    descriptors: NDArray[np.uint64]

    def __len__(self) -> int:
        """Return the number of keypoints."""
        return len(self.points)


_NONE = SubmapFeatures(np.empty((0, 2)), np.empty(0), np.empty((0, _BITS // 64), np.uint64))


def extract_features(points: FloatArray, most: int = _MOST_KEYPOINTS) -> SubmapFeatures:
    """Extract `most` keypoints of the image that the ends of beams (B, 2) make, in m in the submap's frame.

    Corners (Harris) of the blurred occupancy; the direction of a keypoint is that of the intensity centroid of its
    patch, and its descriptor compares pairs of cells in the patch, turned by that direction.

    References
    ----------
    Rublee et al., ORB: an efficient alternative to SIFT or SURF (ICCV 2011).
    """
    if not len(points):
        return _NONE
    cells = np.floor(np.ascontiguousarray(points.T) / _CELL_M).astype(np.int64)
    corner = cells.min(axis=1) - _BORDER
    width, height = (cells.max(axis=1) - corner + _BORDER + 1).tolist()
    column, row = cells - corner[:, None]
    hits = np.bincount(row * width + column, minlength=width * height).reshape(height, width)
    image = np.minimum(1.5 * _blur((hits >= _MIN_HITS).astype(np.float32), 1.0), 1)
    y, x = _find_corners(image, most)
    if not len(y):
        return _NONE
    at = (y * width + x)[:, None]  # cells are counted row by row
    patches = image.take(at + (_DISC_Y * width + _DISC_X))
    headings = np.arctan2(patches @ _DISC_Y.astype(np.float32), patches @ _DISC_X.astype(np.float32)).astype(np.float64)
    c = np.cos(headings)[:, None]
    s = np.sin(headings)[:, None]
    smooth = _blur(image, 1.5)

    def brightness(across: FloatArray, up: FloatArray) -> NDArray[np.float32]:
        aside = np.rint(s * across + c * up) * width + np.rint(c * across - s * up)
        return np.asarray(smooth.take(at + aside.astype(np.int64)), np.float32)

    is_darker = brightness(*_COMPARED[:2]) < brightness(*_COMPARED[2:])
    places = (np.stack([x, y], axis=1) + 0.5 + corner) * _CELL_M
    return SubmapFeatures(places, headings, np.packbits(is_darker, axis=1).view(np.uint64))


def match_features(old: SubmapFeatures, new: SubmapFeatures) -> IntArray:
    """Match keypoints whose descriptors are each other's nearest: pairs (M, 2) of keypoints of both, best first."""
    if not (len(old) and len(new)):
        return np.empty((0, 2), np.int64)
    different = _count_different_bits(old.descriptors, new.descriptors)
    nearest = different.argmin(axis=1)
    is_mutual = different.argmin(axis=0)[nearest] == np.arange(len(old))
    bits = different[np.arange(len(old)), nearest]
    chosen = np.flatnonzero(is_mutual & (bits < _MOST_DIFFERENT_BITS))
    chosen = chosen[np.argsort(bits[chosen], kind="stable")[:_MOST_MATCHES]]
    return np.stack([chosen, nearest[chosen]], axis=1)


def match_nearest_features(old: SubmapFeatures, new: SubmapFeatures, count: int) -> IntArray:
    """Match each new keypoint with the `count` old ones of the nearest descriptors: pairs (M, 2), best first."""
    different = _count_different_bits(new.descriptors, old.descriptors)
    nearest = np.argsort(different, axis=1, kind="stable")[:, :count]
    bits = np.take_along_axis(different, nearest, axis=1).ravel()
    pairs = np.stack([nearest.ravel(), np.repeat(np.arange(len(new)), nearest.shape[1])], axis=1)
    chosen = np.argsort(bits, kind="stable")[: min(_MOST_NEAREST, np.count_nonzero(bits < _MOST_ALIKE_BITS))]
    return pairs[chosen]


def _count_different_bits(a: NDArray[np.uint64], b: NDArray[np.uint64]) -> NDArray[np.float32]:
    """Count the bits (N, M) by which descriptors (N, W) and (M, W) differ: by products of +-1, which are exact."""
    one, other = (2 * np.unpackbits(words.view(np.uint8), axis=1).astype(np.float32) - 1 for words in (a, b))
    return np.asarray(0.5 * (one.shape[1] - one @ other.T), np.float32)


def _find_corners(image: NDArray[np.float32], most: int) -> tuple[IntArray, IntArray]:
    """Rows and columns (K,) of the strongest corners, at least a patch from the border."""
    dy, dx = (np.asarray(slope, np.float32) for slope in np.gradient(image))
    xx = _blur(dx * dx, 1.0)
    xy = _blur(dx * dy, 1.0)
    yy = _blur(dy * dy, 1.0)
    strength = xx * yy - xy * xy - _HARRIS * np.square(xx + yy)
    inner = strength[_PATCH:-_PATCH, _PATCH:-_PATCH]
    across = np.maximum(np.maximum(inner[:, :-2], inner[:, 1:-1]), inner[:, 2:])
    greatest = np.maximum(np.maximum(across[:-2], across[1:-1]), across[2:])
    middle = inner[1:-1, 1:-1]
    rows, columns = np.nonzero((middle > _LEAST_CORNER) & (middle >= greatest))
    rows += _PATCH + 1
    columns += _PATCH + 1
    strongest = np.argsort(-strength[rows, columns], kind="stable")[:most]
    return rows[strongest], columns[strongest]


def _blur(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Convolve with a Gaussian of `sigma` cells; beyond the border is nothing."""
    reach = math.ceil(3 * sigma)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / sigma))
    weights /= weights.sum()
    for _ in ("down", "across"):
        padded = np.zeros((len(image) + 2 * reach, image.shape[1]), np.float32)
        padded[reach:-reach] = image
        blurred = np.float32(weights[reach]) * image
        for k in range(1, reach + 1):
            both = padded[reach - k : -reach - k] + padded[reach + k : len(padded) - reach + k]
            blurred += np.float32(weights[reach + k]) * both
        image = np.ascontiguousarray(blurred.T)
    return image
