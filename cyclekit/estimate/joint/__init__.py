"""Robot and operator rolled out together, in cells where one waits for the other, and plans for both.

In: the robot's nominal motions, the operator's logged walks and stays, who waits for whom (`CouplingCard`), the learned
safety function. Out: cycles with the waits of both, and what ended each; as estimates with the fields of every other.
"""
