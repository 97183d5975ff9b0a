"""Rollout of robot and operator together, for cells in which one waits for the other, and for plans of both agents.

In: the robot's nominal motions, the operator's logged walks and stays, the learned wait conditions (`CouplingCard`),
the learned safety function. Out: cycles with the waits of both agents and the event that ended each; estimates in the
same form as all others.
"""
