"""Map a function over items: in this process, in worker processes, or on a Ray cluster.

In: a function, items, an engine's name. Out: the results; items of a lost worker are repeated. Also limits linear
algebra to one thread. Used by every folder above.
"""
