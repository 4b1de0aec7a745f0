"""Many logs: jobs in child processes and the journal of their results."""
