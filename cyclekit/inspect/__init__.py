"""What a log, a dataset or a model is, as facts that a person checks before trusting an answer.

In: a path. Out: facts, as data and as lines. `describe` is the way in; used by `api`.
"""
