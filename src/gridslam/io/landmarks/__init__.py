"""Landmark logs: MRCLAM and Victoria Park."""
