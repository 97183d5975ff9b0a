"""The speed override of a log that did not record it, inferred from how fast known paths are covered.

In: runs of the same motions. Out: override per row with its standard deviation. `override` is the way in.
"""
