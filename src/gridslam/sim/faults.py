"""Single named faults of a log, each of a given size: what `gridslam doctor` must find, and a map must survive.

A fault is a function from a stream of measurements to the same with the fault in it, in constant memory; what is random
about it is drawn from the generator it is given. `FAULTS` has them all by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from gridslam.arguments import require_generator
from gridslam.errors import ArgumentError
from gridslam.io.measurement import Measurement
from gridslam.sim.odometry_faults import clock_skew, odometry_drift, odometry_rotation_bias, odometry_scale, wheel_slip
from gridslam.sim.scan_faults import (
    beam_count_varies,
    invalid_beams,
    range_limits,
    reflected_laser,
    tilted_laser,
    tilting_laser,
    yaw_offset,
)
from gridslam.sim.stamp_faults import backward_stamps, duplicate_stamps, gaps, standing_still

__all__ = [
    "FAULTS", "Fault", "backward_stamps", "beam_count_varies", "clock_skew", "duplicate_stamps", "gaps",
    "invalid_beams", "odometry_drift", "odometry_rotation_bias", "odometry_scale", "range_limits", "reflected_laser",
    "standing_still", "tilted_laser", "tilting_laser", "wheel_slip", "with_fault", "yaw_offset",
]  # fmt: skip

_Stream = Iterable[Measurement]


class Fault(NamedTuple):
    """A fault by name: (measurements, size, rng) to measurements; its default size, and its unit."""

    apply: Callable[[_Stream, float, np.random.Generator], Iterator[Measurement]]
    size: float
    unit: str


def _certain(fault: Callable[[_Stream, float], Iterator[Measurement]], size: float, unit: str) -> Fault:
    """Make a fault in which nothing is random."""
    return Fault(lambda measurements, size, _: fault(measurements, size), size, unit)


FAULTS: Final[Mapping[str, Fault]] = MappingProxyType({
    "reflected_laser": Fault(lambda measurements, *_: reflected_laser(measurements), 1.0, "yes or no"),
    "yaw_offset": _certain(yaw_offset, math.pi, "rad"),
    "clock_skew": _certain(clock_skew, 0.03, "s"),
    "odometry_scale": _certain(odometry_scale, 0.03, "m/m"),
    "odometry_rotation_bias": _certain(odometry_rotation_bias, 0.05, "rad/rad"),
    "odometry_drift": _certain(odometry_drift, 0.02, "rad/m"),
    "wheel_slip": Fault(wheel_slip, 0.3, "m"),
    "beam_count_varies": Fault(beam_count_varies, 6.0, "beams"),
    "invalid_beams": Fault(invalid_beams, 0.2, "share"),
    "range_limits": _certain(range_limits, 2.0, "m/m"),
    "tilted_laser": _certain(tilted_laser, 0.1, "rad"),
    "tilting_laser": _certain(tilting_laser, 0.3, "rad"),
    "gaps": Fault(gaps, 2.0, "s"),
    "backward_stamps": Fault(backward_stamps, 0.05, "s"),
    "duplicate_stamps": Fault(duplicate_stamps, 0.02, "share"),
    "standing_still": Fault(standing_still, 60.0, "s"),
})  # fmt: skip
"""The faults; those that `gridslam doctor` detects have the codes of its findings as names."""


def with_fault(
    measurements: Iterable[Measurement], name: str, rng: np.random.Generator, size: float | None = None
) -> Iterator[Measurement]:
    """Give a stream the fault of that name, of a size or of the usual one.

    Raises
    ------
    ArgumentError
        There is no such fault.
    """
    require_generator(rng)
    if name not in FAULTS:
        raise ArgumentError("name", f"one of {', '.join(FAULTS)}", repr(name))
    fault = FAULTS[name]
    return fault.apply(measurements, fault.size if size is None else size, rng)
