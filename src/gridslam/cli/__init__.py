"""The command line."""

from time import perf_counter, process_time

__all__ = ["STARTED_S"]

STARTED_S = perf_counter() - process_time()
"""Start of the process, on the clock of `time.perf_counter`; the time before it is taken to be CPU time."""
