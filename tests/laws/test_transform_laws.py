"""Laws of the transform buffer on random trees: what it says is the product of the links along the way.

Links are 10 m long and the trees 12 frames, so a chain adds up to 110 m; rounding of 2^-53 in each of its products
stays below 1e-12 of that.
"""

import numpy as np
import pytest

from gridslam.geometry import rigid
from gridslam.transforms import Coverage, MissingTransform, TransformBuffer
from support import se3

S = 1_000_000_000
FRAMES = 12


def random_transform(rng):
    xyzw = rng.normal(size=4)
    return se3.from_quaternion(rng.uniform(-10, 10, 3), xyzw / np.linalg.norm(xyzw))


def random_tree(rng):
    """Buffer, and the links of its tree: parent, child and readings at 0, 1, 2 s, or one where it is static."""
    buffer = TransformBuffer()
    links = []
    for child in range(1, FRAMES):
        static = rng.random() < 0.5
        links.append((int(rng.integers(child)), child, [random_transform(rng) for _ in range(1 if static else 3)]))
    for k in rng.permutation(len(links)):
        parent, child, readings = links[k]
        for second, reading in enumerate(readings):
            motion = rigid.from_matrix(reading)
            stamp_ns, static = second * S, len(readings) == 1
            buffer.add_quaternion(f"f{parent}", f"/f{child}", stamp_ns, motion[:3], motion[3:], static)
    return buffer, links


def interpolate(a, b, fraction):
    return rigid.to_matrix(rigid.interpolate(rigid.from_matrix(a), rigid.from_matrix(b), fraction))


def truth(links, stamp_ns):
    """root_from_frame of every frame."""
    root_from = [np.eye(4)]
    for parent, _, readings in links:
        second, fraction = divmod(stamp_ns / S, 1)
        here = readings[min(int(second), len(readings) - 1)]
        after = readings[min(int(second) + 1, len(readings) - 1)]
        root_from.append(root_from[parent] @ interpolate(here, after, fraction))
    return root_from


@pytest.mark.parametrize("seed", range(5))
def test_a_lookup_is_the_product_of_the_links(seed):
    rng = np.random.default_rng(seed)
    buffer, links = random_tree(rng)
    for stamp_ns in (0, S, 2 * S, *rng.integers(0, 2 * S, 3).tolist()):
        root_from = truth(links, stamp_ns)
        for target in range(FRAMES):
            for source in range(FRAMES):
                want = np.linalg.inv(root_from[target]) @ root_from[source]
                got = buffer.lookup(f"f{target}", f"f{source}", stamp_ns)
                np.testing.assert_allclose(got, want, rtol=0, atol=1e-10)
                np.testing.assert_allclose(
                    buffer.planar(f"f{target}", f"f{source}", stamp_ns), se3.to_planar(got), rtol=0, atol=1e-10
                )


@pytest.mark.parametrize("seed", range(5))
def test_a_chain_is_known_where_all_its_links_are(seed):
    rng = np.random.default_rng(seed)
    buffer, links = random_tree(rng)
    moving = {child for _, child, readings in links if len(readings) > 1}
    above = {child: parent for parent, child, _ in links}

    def up(frame):
        way = [frame]
        while way[-1]:
            way.append(above[way[-1]])
        return way

    for target in range(FRAMES):
        for source in range(FRAMES):
            between = set(up(target)) ^ set(up(source))  # each stands for the link above it
            static = not between & moving
            for stamp_ns, otherwise in ((-1, Coverage.TOO_EARLY), (2 * S + 1, Coverage.NOT_YET)):
                try:
                    buffer.lookup(f"f{target}", f"f{source}", stamp_ns)
                    coverage = Coverage.KNOWN
                except MissingTransform as missing:
                    coverage = missing.coverage
                assert coverage is (Coverage.KNOWN if static else otherwise)
