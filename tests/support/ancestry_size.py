"""How much an ancestry keeps."""

from __future__ import annotations

from gridslam.particles import Ancestry


def size(ancestry: Ancestry) -> tuple[int, int]:
    """How many first steps are one and the same node for all particles, and how many nodes are kept."""
    arrays = ancestry.to_arrays()
    return len(arrays["trunk"]), len(arrays["trunk"]) + len(arrays["parents"])
