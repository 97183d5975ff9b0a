"""Values that no cell produces: found, named with the likely cure, and kept out.

In: tables of a recording, window by window. Out: the plausible rows, and what was set aside. `validate` is the way in.
"""
