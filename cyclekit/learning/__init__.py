"""Learns the safety function: windows of samples, networks, training, evaluation, and zones.

In: a dataset. Out: a trained model (`networks`), its errors against baselines (`evaluation`), the rule that explains
the logs (`rules`), thresholds and zones (`safety_function`). Only training a network needs torch. Used by `estimate`
and by all rooms that show results.
"""
