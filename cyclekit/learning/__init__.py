"""The safety function, learned: windows of samples, networks, training, evaluation, and zones read back.

In: a dataset. Out: a trained model (`networks`), its errors beside rivals (`evaluation`), the rule that explains the
logs (`rules`), thresholds and zones (`safety_function`). Only `training` and `networks.network` need torch. Used by
`estimate` and all that shows results.
"""
