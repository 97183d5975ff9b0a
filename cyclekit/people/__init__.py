"""The operator: track over time, activity, and the meaning of a silent tracker.

In: tracks of a session in its clock and frame. Out: one position per sample, tasks and goals of the operator, absences.
Used by `derive` and by the operator model of `estimate`.
"""
