"""Logs as tables of comma-separated values."""
