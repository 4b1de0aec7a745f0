"""What a run leaves: states and records."""
