"""What the robot was doing: standstills, places, executions, tasks, dwell, and where each second goes.

In: runs of the robot log (`motion`, `stored_run`). Out: visits, executions, arrivals and departures, usual dwells. Knows
nothing of people. Used by `people`, `scaling` and `derive`.
"""
