"""From a log to a map in one call, and what it gives."""

from gridslam.api.mapping import map_log
from gridslam.api.result import MapResult

__all__ = ["MapResult", "map_log"]
