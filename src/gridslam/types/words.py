"""Stamps and poses as one-line text."""

from __future__ import annotations

from gridslam.scan import FloatArray

__all__ = ["describe_pose", "describe_time"]


def describe_time(stamp_ns: int) -> str:
    """A stamp in seconds, to the millisecond."""
    return f"{stamp_ns * 1e-9:.3f} s"


def describe_pose(pose: FloatArray) -> str:
    """A pose (3,), to the millimetre and the tenth of a milliradian."""
    x, y, theta = pose.tolist()
    return f"x {x:.3f} m, y {y:.3f} m, theta {theta:.4f} rad"
