"""Many logs: jobs in child processes, on this machine or a Dask cluster, and the journal of their results."""
