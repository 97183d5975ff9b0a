"""Evaluates a model on held-out executions against baselines, and tests whether the cell has drifted.

`evaluate` is the entry point.
"""
