"""Configurations by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from gridslam.config.configuration import Configuration
from gridslam.config.tables import replace_parameters, suggest_names
from gridslam.errors import ConfigurationError
from gridslam.matching.hill_climbing import HillClimbing
from gridslam.models.endpoint import GMappingEndPoint
from gridslam.models.motion import GMappingMotion
from gridslam.particles.policies import EffectiveSampleSizeBelow, MotionThreshold
from gridslam.slam.grid_fastslam.proposals import ScanMatchedProposal
from gridslam.slam.tracking.tracker import OdometryTracker

__all__ = ["PRESETS", "preset"]


def _fast() -> Configuration:
    """Half the particles: for a first look, or a small computer."""
    return Configuration(particles=15)


def _accurate() -> Configuration:
    """More particles and key scans: where loops are long and time does not matter."""
    return Configuration(particles=100, when_to_update=MotionThreshold(0.4, 0.25))


def _gmapping() -> Configuration:
    """Decides as GMapping does with the defaults of its ROS node, but for its range, which is the laser's.

    The particles close loops, and nothing else does.
    """
    return Configuration(
        particles=30,
        range_min_m=0.0,
        range_max_m=80.0,
        tracker=OdometryTracker(),
        motion=GMappingMotion(),
        sensor=GMappingEndPoint(),
        proposal=ScanMatchedProposal(matcher=HillClimbing()),
        when_to_update=MotionThreshold(1.0, 0.5),
        when_to_resample=EffectiveSampleSizeBelow(0.5),
        loop_closure=False,
    )


PRESETS: Final[Mapping[str, Callable[[], Configuration]]] = {
    "default": Configuration,
    "fast": _fast,
    "accurate": _accurate,
    "gmapping": _gmapping,
}


def preset(name: str, particles: int | None = None) -> Configuration:
    """Configuration of that name, with a number of particles or the preset's own.

    GMapping divides log weights by 3 for each particle, so in the preset `gmapping` the number decides that, too.

    Raises
    ------
    ConfigurationError
        There is no such preset, or the number is out of range.
    """
    if name not in PRESETS:
        raise ConfigurationError(f"preset: expected {', '.join(PRESETS)}, got {name!r}{suggest_names(name, PRESETS)}")
    config = PRESETS[name]()
    if particles is not None:
        config = replace_parameters(config, {"particles": particles})
    return (
        replace_parameters(config, {"sensor": {"likelihood_gain": 3.0 * config.particles}})
        if name == "gmapping"
        else config
    )
