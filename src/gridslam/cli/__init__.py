"""The command line."""

import os
from time import perf_counter, process_time

__all__ = ["find_start_s"]

for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",  # matrices are 3 x 3 here, its threads would only wait
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYDANTIC_DISABLE_PLUGINS": "__all__",  # else all installed packages are searched for some
}.items():  # which NumPy and pydantic read where they are imported: by what is imported next
    os.environ.setdefault(_name, _value)


def find_start_s() -> float:
    """Return the start of the process on the clock of `time.perf_counter`; all time since is taken to be CPU time."""
    return perf_counter() - process_time()
