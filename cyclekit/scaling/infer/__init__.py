"""Infer the speed override that a log did not record from the speed along known paths.

In: runs of the same motions. Out: override per row with its standard deviation. The entry point is `override`.
"""
