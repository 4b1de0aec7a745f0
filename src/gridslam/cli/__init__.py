"""The command line."""

from time import perf_counter, process_time

__all__ = ["STARTED_S"]

STARTED_S = perf_counter() - process_time()
"""When the process was started, on the clock of `time.perf_counter`; what passed before is taken to be CPU time."""
