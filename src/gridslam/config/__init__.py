"""The configuration of a run: presets, TOML in and out, single parameters by name, and the filter built from it."""

from gridslam.config.configuration import PARAMETERS, Configuration, build, dumps, load, loads, override
from gridslam.config.presets import PRESETS, preset

__all__ = ["PARAMETERS", "PRESETS", "Configuration", "build", "dumps", "load", "loads", "override", "preset"]
