"""Expected cycle times of task sequences: from a learned safety function and logged operator tracks.

In: a dataset, a model, sequences. Out: estimates with intervals (`rollout`), the best order (`plan`), cycle times of a
changed cell (`whatif`). `joint` and `task_times` cover cells with waits and cells with task lists. `estimators` lists
the estimators. Used by `api`, `report` and `inspect`.
"""
