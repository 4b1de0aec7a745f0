"""Saved states of runs and localizations, which can be continued."""
