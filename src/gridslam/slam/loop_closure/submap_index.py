"""Which key scans make which submap: submap b is made of consecutive key scans, and has the frame of its anchor."""

from __future__ import annotations

__all__ = ["KEY_SCANS_PER_SUBMAP", "anchor_of", "first_key_scan", "submap_of"]

KEY_SCANS_PER_SUBMAP = 10
"""Key scans of a submap: about 5 m of driving."""


def submap_of(key: int) -> int:
    """Index of the submap that a key scan belongs to."""
    return key // KEY_SCANS_PER_SUBMAP


def first_key_scan(submap: int) -> int:
    """Index of the first key scan of a submap."""
    return submap * KEY_SCANS_PER_SUBMAP


def anchor_of(submap: int) -> int:
    """The key scan in whose frame a submap is."""
    return first_key_scan(submap) + KEY_SCANS_PER_SUBMAP // 2
