"""Many logs: one command over all of them, and what came of it as a page, as a table and beside an earlier run."""
