"""The operator: his track over time, what he did, and what a silent tracker means.

In: tracks of a session in its clock and frame. Out: one position per sample, tasks and goals of the operator, absences.
Used by `derive` and by the operator model of `estimate`.
"""
