"""Checks for implausible values: found, reported with the likely cure, and removed.

In: tables of a recording, window by window. Out: the plausible rows, and the rows set aside. Entry point: `validate`.
"""
