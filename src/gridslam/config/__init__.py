"""The configuration of a run: presets, TOML in and out, single parameters by name, and the filter built from it."""

from gridslam.config.configuration import (
    PARAMETERS,
    Configuration,
    Parameter,
    Search,
    build,
    dumps,
    load,
    loads,
    override,
)
from gridslam.config.presets import LASERS, PRESETS, apply_laser, preset

__all__ = [
    "LASERS",
    "PARAMETERS",
    "PRESETS",
    "Configuration",
    "Parameter",
    "Search",
    "apply_laser",
    "build",
    "dumps",
    "load",
    "loads",
    "override",
    "preset",
]
