"""Signals that show people where there is no tracker, and those that show none."""
