"""What decides how the node listens and speaks; what the filter does is decided by `Configuration`."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias, final

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

__all__ = ["NodeSettings"]


def _strip_slash(frame: str) -> str:
    if not (bare := frame.lstrip("/")):
        raise ValueError("expected the name of a frame")
    return bare


Frame: TypeAlias = Annotated[str, AfterValidator(_strip_slash)]
"""Name of a frame; "/odom" of the days before tf2 is "odom"."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class NodeSettings:
    """Frames, rates and bounds of the node; the defaults with a ROS name are slam_gmapping's.

    Parameters
    ----------
    base_frame, odom_frame, map_frame : str
        The robot, its odometry, and the map that is made.
    odometry : str
        "needed": a scan without odometry is refused; "optional": it is matched without; "none": none is asked for.
    map_update_interval_s : float, s
        Between two maps; 0: one after each scan, as fast as they are drawn.
    transform_publish_period_s : float, s
        Between two transforms from map to odometry; 0: none is published.
    tf_delay_s : float, s
        How far in the future that transform is stamped: until then it may be used.
    throttle_scans : int
        Take every so many-th scan.
    transform_wait_s : float, s
        How long a scan waits for the transforms at its stamp.
    queue_s, queue_scans : float in s, int
        Scans that came so long before the newest one, or are more than so many, are dropped, oldest first: the filter
        is never further behind. Half a second bridges the correction of a loop.
    jump_s : float, s
        Two scans in a row that are stamped so much before the last one: time has jumped back.
    map_values : str
        "trinary": 0, 100 and -1 as in map.pgm; "probability": 0 to 100 in per cent, -1 where nothing is known.
    min_beams, max_beams : int
        Scans of fewer or more are refused.
    seed, threads : int
        As of `map_log`: the first begins anew with each session, the second never changes a result.
    """

    base_frame: Frame = "base_link"
    odom_frame: Frame = "odom"
    map_frame: Frame = "map"
    odometry: Literal["needed", "optional", "none"] = "needed"
    map_update_interval_s: float = Field(default=5.0, ge=0)
    transform_publish_period_s: float = Field(default=0.05, ge=0)
    tf_delay_s: float = Field(default=0.05, ge=0)
    throttle_scans: int = Field(default=1, ge=1)
    transform_wait_s: float = Field(default=0.5, ge=0)
    queue_s: float = Field(default=0.75, gt=0)
    queue_scans: int = Field(default=100, ge=1)
    jump_s: float = Field(default=1.0, gt=0)
    map_values: Literal["trinary", "probability"] = "trinary"
    min_beams: int = Field(default=10, ge=1)
    max_beams: int = Field(default=100_000, ge=1)
    seed: int = Field(default=0, ge=0)
    threads: int = Field(default=1, ge=1, le=256)
