"""Files of a run: states and records."""
