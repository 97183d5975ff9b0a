"""One function mapped over many items: in this process, in worker processes, or on a Ray cluster.

In: a function, items, an engine's name. Out: the results in order; a lost worker's items are done again. Linear algebra
on one thread is here, too. Every room above may use it.
"""
