"""Facts about a log, a dataset or a model, to check before relying on results.

In: a path. Out: facts, as data and as lines. The entry point is `describe`; used by `api`.
"""
