"""Settings of the node itself; `Configuration` has those of the filter."""

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
"""Name of a frame without tf1's leading slash: "/odom" becomes "odom"."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class NodeSettings:
    """Frames, rates and bounds of the node; the defaults with a ROS name are slam_gmapping's.

    Parameters
    ----------
    base_frame, odom_frame, map_frame : str
        Frames of the robot, its odometry and the map.
    odometry : str
        "needed": scans without odometry are refused; "optional": they are matched without; "none": odometry is ignored.
    map_update_interval_s : float, s
        Time between two maps; 0: a map after each scan, as fast as rendering permits.
    transform_publish_period_s : float, s
        Time between two transforms from map to odometry; 0: no transform is published.
    tf_delay_s : float, s
        How far in the future that transform is stamped, i.e. how long it is valid.
    throttle_scans : int
        Use every n-th scan.
    transform_wait_s : float, s
        How long a scan waits for the transforms at its stamp.
    queue_s, queue_scans : float in s, int
        Limits of the queue: scans older than the newest by more than this, or beyond this number, are dropped, oldest
        first: the filter is never further behind. Half a second bridges the correction of a loop.
    jump_s : float, s
        Time has jumped back if two scans in a row are stamped this much before the last one.
    map_values : str
        "trinary": 0, 100 and -1 as in map.pgm; "probability": 0 to 100 in per cent, -1 where unknown.
    min_beams, max_beams : int
        Scans with fewer or more beams are refused.
    seed, threads : int
        As in `map_log`: the generator is re-seeded for each session; the threads do not affect results.
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
