"""From a log to a map, or to a log of another format, in one call, and what it gives."""

from gridslam.api.conversion import Conversion, convert_log
from gridslam.api.mapping import map_log
from gridslam.api.result import MapResult

__all__ = ["Conversion", "MapResult", "convert_log", "map_log"]
