"""Segments the robot log: standstills, places, executions, tasks, dwell, and the time account of each task.

In: runs of the robot log (`motion`, `stored_run`). Out: visits, executions, arrivals and departures, usual dwells.
Does not use data of people. Used by `people`, `scaling` and `derive`.
"""
