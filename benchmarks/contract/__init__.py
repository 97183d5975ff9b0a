"""The contract: what cyclekit answers for simulated cells, beside the truth, as one file to compare with later.

`cells` says which cells and orders, `measure` logs and answers them, `compare` holds two results against each other.
"""
