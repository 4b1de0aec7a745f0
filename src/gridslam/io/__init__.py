"""Readers and writers of logs, maps, trajectories and results."""
